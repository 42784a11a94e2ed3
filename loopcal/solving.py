"""`loopcal solve`: the table on the terminal, the JSON file and the HTML report."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from loopcal.console import fail, out
from recordings.reader import read_recording
from solver.estimate.robust import Loss
from solver.estimate.trust_region import Status
from solver.poses.criteria import criterion_named
from solver.report.report import write_report
from solver.report.summary import summary
from solver.result import result
from solver.solve import Solution, solve

_STYLE = {"good": "green", "fair": "yellow", "bad": "red"}


def run_solve(
    file: Path,
    *,
    poses: int,
    method: str | None,
    loss: str,
    use_priors: bool,
    criterion: str,
    json_file: Path | None,
    report: Path | None,
    truth: Path | None,
) -> bool:
    """Solve a recording and write what was asked for; whether it converged."""
    known = None if truth is None else read_truth(truth)
    recording = read_recording(file)
    with out.status("solving"):
        solution = solve(
            recording,
            poses=poses,
            method=method,
            loss=Loss(loss),
            use_priors=use_priors,
            criterion=criterion_named(criterion),
        )
    if json_file is not None:
        write_json(result(solution), json_file)
    if report is not None:
        with out.status("writing the report"):
            write_report(solution, report, truth=known, recording=recording, overwrite=True)
    show(solution, known)
    return solution.estimate.status is Status.CONVERGED


def show(solution: Solution, truth: Mapping[str, float] | None = None) -> None:
    """Print the parameters and the verdict; the truth beside them where it is known."""
    told = summary(solution)
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in told.columns:
        table.add_column(column, justify="left" if column in ("parameter", "unit") else "right")
    errors: dict[str, float] = {}
    if truth is not None:
        estimate = solution.estimate
        for name, value, se in zip(
            estimate.space.names, estimate.values, estimate.standard_errors, strict=True
        ):
            parameter = next(p for p in estimate.space.table if p.name == name)
            errors[name] = (value / parameter.to_si - truth[name]) / (se / parameter.to_si)
        table.add_column("error / SE", justify="right")
    for row in told.rows:
        extra = (f"{errors[row[0]]:+.2f}",) if truth is not None else ()
        table.add_row(*row, *extra)
    out.print(table)
    for label, value in told.facts:
        out.print(f"{label}: {value}", markup=False, soft_wrap=True)
    estimate = solution.estimate
    if estimate.weights is not None and len(estimate.downweighted):
        poses = solution.selection.poses
        told_weights = ", ".join(
            f"{poses[i]} ({estimate.weights[i]:.2f})" for i in estimate.downweighted
        )
        out.print(f"poses weighed down (weight): {told_weights}", markup=False, soft_wrap=True)
    out.print(Text(told.verdict, style=_STYLE.get(told.grade, "")), soft_wrap=True)


def read_truth(path: Path) -> dict[str, float]:
    """True parameters by name in shown units, from the file that a simulation wrote."""
    try:
        document: Any = json.loads(path.read_text("utf-8"))
        return {str(name): float(value) for name, value in document["parameters"].items()}
    except OSError as error:
        fail(f"cannot read the truth file '{path}': {error.strerror}")
    except (ValueError, KeyError, TypeError, AttributeError):
        fail(f"'{path}' is not a truth file; `loopcal simulate --truth FILE` writes one")


def write_json(document: Mapping[str, Any], path: Path) -> None:
    """Write a result file in one step, so that no reader ever sees half of it."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        fail(f"cannot write '{path}': {error.strerror}")
