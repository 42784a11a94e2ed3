"""The report of a solve: one HTML file that needs nothing else, on screen or on paper.

Owns what stands in it and in which order (the template owns the looks). Refuses to replace
a file unless told to; a report is written whole or not at all. The same solution gives the
same bytes.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from numpy.typing import NDArray

from recordings.reader import Recording
from recordings.rig import Rig
from recordings.session import SOFTWARE, to_metadata
from solver.errors import SolverError
from solver.estimate.nuisance import Observations
from solver.mechanism.space import ParameterSpace
from solver.poses.criteria import IN_WORDS
from solver.report.channels import channel_summaries
from solver.report.comparison import compare
from solver.report.judged import judged
from solver.report.leverage import expected_residuals
from solver.report.notation import (
    coded,
    decimals_for,
    figures,
    fixed,
    plain,
    signed,
    typeset,
    unit_of,
)
from solver.report.pictures.changes import changes
from solver.report.pictures.closures import closures
from solver.report.pictures.residuals import residuals
from solver.report.pictures.selected import selected
from solver.report.pictures.sensitivity import sensitivity_picture
from solver.report.pictures.singular_values import singular_values
from solver.report.verdict import ACCEPTABLE_CONDITION, certificate, verdict
from solver.sensitivity import Sensitivity, sensitivity
from solver.solve import Solution


class ReportError(SolverError):
    """A report cannot be written where it was asked for."""


def write_report(
    solution: Solution,
    path: Path,
    *,
    truth: Mapping[str, float] | None = None,
    recording: Recording | None = None,
    overwrite: bool = False,
) -> None:
    """Write the report of ``solution``.

    Args:
        solution: the solve.
        path: the HTML file to write.
        truth: true parameters by name, in the units of the result file (m, deg, m/count,
            deg/count), to stand beside the estimates.
        recording: what was solved, for its session, ledger and faults.
        overwrite: whether a file at ``path`` may be replaced.

    Raises:
        ReportError: there is a file already, or it cannot be written.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise ReportError(
            f"there is already something at '{path}'; give another name for the report, or allow it to be overwritten"
        )
    write_page(render(solution, truth=truth, recording=recording), path)


def write_page(page: str, path: Path) -> None:
    """Write a page whole or not at all; raises ReportError."""
    # Beside its target, so that taking its place is one step of the file system.
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(page.encode("utf-8"))
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ReportError(f"cannot write the report '{path}': {error.strerror}") from error


def render(
    solution: Solution,
    *,
    truth: Mapping[str, float] | None = None,
    recording: Recording | None = None,
) -> str:
    """The page that `write_report` writes."""
    estimate, space = solution.estimate, solution.estimate.space
    rows = compare(solution, truth)
    expected = expected_residuals(
        solution.model, solution.table, solution.after.coordinates, estimate.parameters
    )
    methods = [estimate.method, *(other.method for other in solution.beside)]
    jacobians = judged(solution)
    before, after = solution.closure_before, solution.closure_after
    identified = set(space.names)
    return template().render(
        solution=solution,
        estimate=estimate,
        rig=solution.rig,
        verdict=verdict(solution, rows),
        rows=rows,
        known=any(row.truth is not None for row in rows),
        stated=[
            (parameter, float(value) / unit_of(parameter).to_si, unit_of(parameter).name)
            for parameter, value in zip(space.table, estimate.parameters, strict=True)
            if parameter.name not in identified
        ],
        certificate=certificate(solution),
        criterion=IN_WORDS[solution.selection.criterion],
        acceptable=ACCEPTABLE_CONDITION,
        jacobians=jacobians,
        channels=channel_summaries(solution, expected),
        changes=changes(rows, methods[0], methods[1:]),
        residuals=residuals(solution, expected),
        closures=None
        if before is None or after is None
        else closures(before, after, solution.selection.poses),
        selected=selected(solution),
        singular_values=singular_values(jacobians, methods, ACCEPTABLE_CONDITION),
        sensitivity=sensitivity_picture(*_sensitivity(solution)),
        recording=recording,
        session={} if recording is None else to_metadata(recording.session),
        software=SOFTWARE,
        command=_command(solution, recording),
    )


def _sensitivity(solution: Solution) -> tuple[Sensitivity, NDArray[np.float64]]:
    """Of the endpoint or plate to what the rig identifies or doubts, with the standard errors reached."""
    estimate, used, table = solution.estimate, solution.selection.poses, solution.table
    reached = dict(zip(estimate.space.names, np.sqrt(np.diag(estimate.covariance)), strict=True))
    names = [
        p.name
        for p in estimate.space.table
        if p.tie is None and (p.name in reached or p.uncertainty)
    ]
    found = sensitivity(
        solution.model,
        ParameterSpace.of(estimate.space.table, names),
        estimate.parameters,
        Observations(table.counts, table.sigma, table.circumstances(solution.rig)).take(used),
        solution.after.coordinates[used],
    )
    return found, np.array([reached.get(name, np.nan) for name in names])


def render_sensitivity(rig: Rig, found: Sensitivity) -> str:
    """A page about the sensitivity of the endpoint or plate of ``rig``, without a recording."""
    return template("sensitivity.html.jinja").render(
        rig=rig,
        found=found,
        degree=np.pi / 180.0,
        picture=sensitivity_picture(found),
        software=SOFTWARE,
    )


def template(name: str = "report.html.jinja") -> Template:
    """A page's template, with what all pages need to write numbers."""
    environment = Environment(
        loader=PackageLoader("solver.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = typeset
    environment.filters["coded"] = coded
    environment.filters["capitalised"] = lambda text: text[:1].upper() + text[1:]
    environment.globals.update(
        fixed=lambda value, digits: typeset(fixed(value, digits)),
        signed=lambda value, digits: typeset(signed(value, digits)),
        figures=lambda value, count=3: typeset(figures(value, count)),
        plain=lambda value: typeset(plain(value)),
        decimals_for=decimals_for,
    )
    return environment.get_template(name)


def _command(solution: Solution, recording: Recording | None) -> str:
    """The command that makes this report again."""
    file = "RECORDING.mcap" if recording is None else shlex.quote(str(recording.path))
    return (
        f"loopcal solve {file} -n {len(solution.selection.poses)} "
        f"--method {solution.method.name} --report REPORT.html"
    )
