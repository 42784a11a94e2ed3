"""`loopcal doctor`: what is wrong with a recording, how bad that is, and what to do about it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.padding import Padding
from rich.text import Text

from loopcal.console import out
from loopcal.info import state
from loopcal.surveying import look_through
from recordings.health import Finding, Severity, findings
from recordings.survey import Survey

_STYLE = {Severity.BAD: "red", Severity.CAUTION: "yellow", Severity.NOTE: "cyan"}


def run_doctor(paths: Sequence[Path], *, as_json: bool) -> int:
    """Show what is wrong with each recording; returns the exit code."""
    told: list[dict[str, Any]] = []

    def show(found: Survey) -> bool:
        seen = findings(found)
        if as_json:
            told.append(_described(found, seen))
        else:
            _show(found, seen)
        return not any(finding.severity is Severity.BAD for finding in seen)

    code = look_through(paths, show)
    if as_json:
        out.print_json(json.dumps({"schema": 1, "recordings": told}), indent=2)
    return code


def _described(found: Survey, seen: Sequence[Finding]) -> dict[str, Any]:
    return {
        "path": str(found.files[0].path),
        "state": state(found),
        "findings": [
            {
                "severity": str(finding.severity),
                "kind": finding.kind,
                "text": finding.text,
                "remedy": finding.remedy,
            }
            for finding in seen
        ],
    }


def _show(found: Survey, seen: Sequence[Finding]) -> None:
    head = Text.assemble((str(found.files[0].path), "bold"), f": {_verdict(found, seen)}")
    out.print(head, soft_wrap=True)
    for finding in seen:
        style = _STYLE[finding.severity]
        line = Text.assemble((f"{finding.severity}: ", f"bold {style}"), finding.text)
        out.print(Padding(line, (0, 0, 0, 2), expand=False))
        if finding.remedy:
            out.print(Padding(Text(finding.remedy, style="dim"), (0, 0, 0, 6), expand=False))


def _verdict(found: Survey, seen: Sequence[Finding]) -> str:
    if found.hopeless:
        return f"hopeless: {found.hopeless}"
    if found.damage:
        return "damaged, but readable"
    if any(finding.severity is Severity.BAD for finding in seen):
        return "whole, but not well"
    if any(finding.severity is Severity.CAUTION for finding in seen):
        return "whole, with remarks"
    return "whole and well"
