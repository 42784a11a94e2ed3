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
from solver.report.notation import figures
from solver.report.pictures.canvas import Picture
from solver.report.pictures.gap_held_out import held_out_picture
from solver.report.pictures.gap_maps import disagreements, pose_maps
from solver.report.pictures.gap_pattern import pattern_picture
from solver.report.report import template, write_page
from solver.report.verdict import Fact, Grade

_GRADES: dict[Verdict, Grade] = {
    Verdict.NAMED: "good",
    Verdict.AMBIGUOUS: "caution",
    Verdict.NOTHING: "good",
    Verdict.UNKNOWN: "bad",
}
_SIGNIFICANT = 2.0  # standard errors
_SMALL = 0.1
_LACK = 0.01


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
    strange = gap_words.strangest(gap) if gap.verdict is Verdict.UNKNOWN else ()
    return template("gap.html.jinja").render(
        gap=gap,
        strange=strange,
        pattern=pattern_picture(gap.search.after.fit, strange[0], gap_words.pattern(strange[0]))
        if strange
        else None,
        rig=recording.rig,
        grade=_grade(gap),
        facts=_facts(gap),
        held_out=None
        if gap.held_out is None
        else held_out_picture(gap.held_out, bool(gap.effects)),
        maps=_maps(gap),
        words=gap_words,
        next_poses=next_poses,
        session=to_metadata(recording.session),
        recorded=bool(recording.session.start_ns),
        software=SOFTWARE,
        command=f"loopcal gap {shlex.quote(str(recording.path))} --seed {seed} --report PAGE.html",
    )


def _grade(gap: Gap) -> Grade:
    doubtful = (gap.provisional and gap.effects) or gap.cautions
    grade = _GRADES[gap.verdict]
    return "caution" if doubtful and grade == "good" else grade


def _maps(gap: Gap) -> tuple[Picture, ...]:
    """Every channel against the rest, before and, where something was found, after."""
    first, last = gap.disagreement_before, gap.disagreement_after
    if not gap.effects:
        return disagreements(gap.before, first, after=False), pose_maps(gap.before, first, None)
    return (
        disagreements(gap.before, first, after=False),
        disagreements(gap.after, last, after=True),
        pose_maps(gap.before, first, last),
    )


def _facts(gap: Gap) -> tuple[Fact, ...]:
    """The numbers behind the verdict, and how to take each."""
    out = []
    held = gap.held_out
    if held is None:
        out.append(Fact("Gap", "not tested", gap_words.gap_closed(gap), "caution"))
    else:
        note = f"on {held.poses} held-out poses, where 1 is noise alone"
        out.append(
            Fact(
                "Gap as described", figures(held.before), note, "caution" if held.opens else "good"
            )
        )
        if gap.effects:
            left = held.after - 1.0 > max(_SIGNIFICANT * held.after_error, _SMALL)
            closed = (
                "there was no significant gap"
                if held.closed is None
                else f"{gap_words.share(held.closed)} of the gap is closed"
            )
            out.append(
                Fact(
                    "Gap with it added", figures(held.after), closed, "caution" if left else "good"
                )
            )
    floor = gap.floor_after
    out.append(
        Fact(
            "Lack of fit",
            f"F = {figures(floor.ratio)}",
            f"{gap_words.chance(floor.p)}; F near 1 is noise alone",
            "good" if floor.p >= _LACK else "caution",
        )
    )
    tested = len(gap.search.before.candidates)
    out.append(
        Fact(
            "Tested",
            f"{tested}",
            f"effects at a place; {len(gap.untested)} more could not be tested",
            "good",
        )
    )
    out.append(
        Fact(
            "Visited again",
            f"{floor.revisited}",
            "poses: noise from visit to visit is not known"
            if floor.provisional
            else "poses, from which noise is known",
            "caution" if floor.provisional else "good",
        )
    )
    return tuple(out)
