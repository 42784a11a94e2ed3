"""The report of a gap analysis: one HTML file that needs nothing else, in the look of a solve's.

Owns what stands in it and in which order. The same analysis gives the same bytes.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from recordings.reader import Recording
from recordings.session import SOFTWARE, to_metadata
from solver.gap.result import Gap, Verdict
from solver.report import gap_words
from solver.report.report import template, write_page
from solver.report.verdict import Grade

_GRADES: dict[Verdict, Grade] = {
    Verdict.NAMED: "good",
    Verdict.AMBIGUOUS: "caution",
    Verdict.NOTHING: "good",
    Verdict.UNKNOWN: "bad",
}


def write_gap_report(
    gap: Gap,
    path: Path,
    *,
    recording: Recording,
    seed: int = 1,
    next_poses: str | None = None,
) -> None:
    """Write the report of ``gap``, in the place of a report that is there already.

    Args:
        gap: the analysis.
        path: the HTML file to write.
        recording: what was analysed, for its session and its name.
        seed: of the analysis, for the command that repeats it.
        next_poses: path of a plan that was written for the next capture, if one was.

    Raises:
        ReportError: it cannot be written.
    """
    write_page(render_gap(gap, recording=recording, seed=seed, next_poses=next_poses), path)


def render_gap(
    gap: Gap, *, recording: Recording, seed: int = 1, next_poses: str | None = None
) -> str:
    """The page that `write_gap_report` writes."""
    return template("gap.html.jinja").render(
        gap=gap,
        rig=recording.rig,
        grade="caution" if gap.provisional and gap.effects else _GRADES[gap.verdict],
        facts=(),
        held_out=None,
        maps=(),
        words=gap_words,
        next_poses=next_poses,
        session=to_metadata(recording.session),
        recorded=bool(recording.session.start_ns),
        software=SOFTWARE,
        command=f"loopcal gap {shlex.quote(str(recording.path))} --seed {seed} --report PAGE.html",
    )
