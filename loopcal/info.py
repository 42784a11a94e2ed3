"""`loopcal info`: what a recording is, on one screen or as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from loopcal.console import out
from loopcal.surveying import look_through
from loopcal.timing_view import described, show_timing
from recordings.events import Dwell
from recordings.rig import SerialMechanism
from recordings.survey import Survey
from recordings.timing import DeviceTiming, timings

_SECOND = 1_000_000_000
_SHOWN = 12
_STYLE = {"whole": "green", "damaged": "yellow", "hopeless": "red"}


def run_info(paths: Sequence[Path], *, as_json: bool) -> int:
    """Show each recording; returns the exit code."""
    described: list[dict[str, Any]] = []

    def show(found: Survey) -> bool:
        if as_json:
            described.append(description(found))
        else:
            _show(found)
        return state(found) == "whole"

    code = look_through(paths, show)
    if as_json:
        out.print_json(json.dumps({"schema": 1, "recordings": described}), indent=2)
    return code


def state(found: Survey) -> str:
    """``whole``, ``damaged`` or ``hopeless``."""
    if found.hopeless:
        return "hopeless"
    return "damaged" if found.damage else "whole"


def description(found: Survey) -> dict[str, Any]:
    """All that `info` knows of a recording, as JSON has it; the keys are in docs/formats.md."""
    session = found.session
    return {
        "state": state(found),
        "files": [
            {
                "path": str(file.path),
                "bytes": file.size,
                "part": file.part.number,
                "closed": file.closed,
                "damage": [str(each) for each in file.damage],
            }
            for file in found.files
        ],
        "damage": list(found.damage),
        "rig": None if found.rig is None else found.rig.name,
        "session": {
            "session_id": session.session_id,
            "operator": session.operator,
            "notes": session.notes,
            "host": session.host,
            "software": session.software,
            "start_ns": session.start_ns,
        },
        "start_ns": found.start_ns,
        "duration_s": (found.end_ns - found.start_ns) / _SECOND,
        "channels": [_channel(found, name) for name in _channels(found)],
        "other_messages": found.other,
        "dwells": len(found.dwells),
        "poses": _poses(found),
        "states": [
            {"time_ns": s.time_ns, "before": s.before.name, "after": s.after.name, "cause": s.cause}
            for s in found.states
        ],
        "timing": described(_timing(found)),
        "marks": [{"time_ns": mark.time_ns, "text": mark.text} for mark in found.marks],
        "faults": [
            {"time_ns": f.time_ns, "source": f.source, "kind": f.kind, "text": f.text}
            for f in found.faults
        ],
        "recovery": dict(found.recovery),
    }


def _timing(found: Survey) -> tuple[DeviceTiming, ...]:
    if found.rig is None:
        return ()
    return timings(found.rig, found.clock, found.round_trips)


def _channels(found: Survey) -> tuple[str, ...]:
    named = () if found.rig is None else tuple(channel.name for channel in found.rig.channels)
    return (*named, *(name for name in found.readings if name not in named))


def _channel(found: Survey, name: str) -> dict[str, Any]:
    tally, entry = found.channel(name), found.ledger.get(name)
    span = (tally.last_ns - tally.first_ns) / _SECOND
    ledger = None
    if entry is not None:
        ledger = {
            "expected": entry.expected,
            "received": entry.received,
            "dropped_by_device": entry.dropped_by_device,
            "dropped_by_host": entry.dropped_by_host,
            "lost_in_gaps": entry.lost_in_gaps,
            "gaps": entry.gaps,
            "unaccounted": entry.unaccounted,
        }
    known = found.rig is not None and any(c.name == name for c in found.rig.channels)
    return {
        "name": name,
        "senses": found.rig.channel(name).senses if found.rig is not None and known else None,
        "readings": tally.count,
        "rate_hz": (tally.count - 1) / span if tally.count > 1 and span > 0 else None,
        "missing": tally.missing if tally.count or tally.holes else 0,
        "ledger": ledger,
    }


def _poses(found: Survey) -> int:
    return len({dwell.pose for dwell in found.dwells})


def _show(found: Survey) -> None:
    name = str(found.files[0].path)
    told = state(found)
    out.print(Text.assemble((name, "bold"), ": ", (told, _STYLE[told])), soft_wrap=True)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for label, value in _facts(found):
        table.add_row(label, Text(value))
    out.print(table)
    out.print()
    out.print(_channel_table([_channel(found, each) for each in _channels(found)]))
    show_timing(_timing(found))
    for label, lines in (
        ("marks", [(mark.time_ns, mark.text) for mark in found.marks]),
        ("faults", [(f.time_ns, f"{f.source} {f.kind}: {f.text}") for f in found.faults]),
    ):
        _list(found, label, lines)
    if found.damage:
        out.print()
        text = f"damaged in {len(found.damage)} place{'s' if len(found.damage) > 1 else ''}; "
        text += "loopcal doctor says what that means" if not found.hopeless else found.hopeless
        out.print(Text(text, style=_STYLE[told]), soft_wrap=True)


def _facts(found: Survey) -> list[tuple[str, str]]:
    session, files = found.session, found.files
    facts = [("rig", _rig(found))]
    who = [
        f"{word} {value}"
        for word, value in (
            ("by", session.operator),
            ("on", session.host),
            ("with", session.software),
        )
        if value
    ]
    facts.append(("session", ", ".join([session.session_id or "(no name)", *who])))
    if session.notes:
        facts.append(("notes", session.notes.strip()))
    facts.append(("start", _utc(found.start_ns) if found.start_ns else "unknown"))
    facts.append(("duration", _duration((found.end_ns - found.start_ns) / _SECOND)))
    size = sum(file.size for file in files)
    facts.append(("size", _size(size)))
    if len(files) > 1 or files[0].part.number > 1:
        first, last = files[0].part.number, files[-1].part.number
        which = f"{first} to {last}" if last > first else str(first)
        facts.append(("parts", f"{which}: {', '.join(file.path.name for file in files)}"))
    if found.recovery:
        facts.append(("recovered", f"from {found.recovery.get('source', '')}"))
    facts.append(("dwells", _dwells(found)))
    if found.other:
        facts.append(("other", f"{found.other} messages that are not loopcal's"))
    return facts


def _rig(found: Survey) -> str:
    if found.rig is None:
        return found.rig_error or "lost"
    family = "serial" if isinstance(found.rig.mechanism, SerialMechanism) else "platform"
    return f"{found.rig.name} ({family}, {len(found.rig.channels)} channels)"


def _dwells(found: Survey) -> str:
    if not found.dwells:
        return "none"
    lengths = [_length_s(dwell) for dwell in found.dwells]
    shortest, longest = f"{min(lengths):.2f}", f"{max(lengths):.2f}"
    each = longest if shortest == longest else f"{shortest} to {longest}"
    return f"{len(found.dwells)} at {_poses(found)} poses, {each} s each"


def _length_s(dwell: Dwell) -> float:
    return (dwell.end_ns - dwell.start_ns) / _SECOND


def _channel_table(channels: Sequence[Mapping[str, Any]]) -> Table:
    """Readings and losses by channel; a column for missing readings only where some are."""
    missing = any(channel["missing"] != 0 for channel in channels)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    heads = ["channel", "senses", "readings", "rate", "lost: device", "host", "gaps", "unknown"]
    for head in (*heads, *(["damage"] if missing else [])):
        left = head in ("channel", "senses")
        table.add_column(head, justify="left" if left else "right", no_wrap=True)
    for channel in channels:
        rate, ledger = channel["rate_hz"], channel["ledger"]
        losses: list[Text] = []
        for key in ("dropped_by_device", "dropped_by_host", "lost_in_gaps", "unaccounted"):
            lost = None if ledger is None else ledger[key]
            losses.append(_loss(lost, "red" if key == "unaccounted" else "yellow"))
        if missing:
            losses.append(_loss(channel["missing"], "red"))
        table.add_row(
            channel["name"],
            channel["senses"] or "",
            str(channel["readings"]),
            "" if rate is None else f"{rate:.4g} Hz",
            *losses,
        )
    return table


def _loss(count: int | None, style: str) -> Text:
    return Text("?" if count is None else str(count), style=style if count else "")


def _list(found: Survey, label: str, lines: Sequence[tuple[int, str]]) -> None:
    if not lines:
        return
    out.print()
    out.print(Text(f"{label} ({len(lines)})", style="bold"))
    for time_ns, text in lines[:_SHOWN]:
        at = f"{(time_ns - found.start_ns) / _SECOND:9.1f} s  "
        out.print(Text(at + text), soft_wrap=True)
    if len(lines) > _SHOWN:
        out.print(f"and {len(lines) - _SHOWN} more; --json lists all", markup=False)


def _utc(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns / _SECOND, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min {rest} s" if hours else f"{minutes} min {rest} s"


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 100_000 else f"{size / 1e3:.1f} kB"
