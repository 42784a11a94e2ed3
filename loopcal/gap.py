"""`loopcal gap`: what is missing from a rig, on the terminal, as JSON, as a page, and as a grown rig."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from loopcal.console import err, fail, out
from loopcal.files import create
from loopcal.gap_rig import grown_rig
from loopcal.progress import bar
from loopcal.solving import write_json
from recordings.reader import Recording, read_recording
from solver.gap.analysis import analyse
from solver.gap.result import Gap, Verdict, gap_json
from solver.gap.together import together
from solver.report import gap_words as words

_STYLE = {
    Verdict.NAMED: "green",
    Verdict.AMBIGUOUS: "yellow",
    Verdict.NOTHING: "green",
    Verdict.UNKNOWN: "red",
}
_STANDARD_OUTPUT = Path("-")


def run_gap(
    file: Path,
    *,
    seed: int,
    json_file: Path | None,
    report: Path | None,
    rig_out: Path | None,
    more: Sequence[Path] = (),
    next_plan: Path | None = None,
    next_for: str | None = None,
) -> bool:
    """Analyse recordings and write what was asked for; whether the answer has a name or needs none."""
    for path in (rig_out, next_plan):
        if path is not None and path.exists():
            fail(f"'{path}' exists already; choose another name, nothing was overwritten")
    if next_for is not None and next_plan is None:
        fail("--next-for says what the next poses are for; say with --next where their plan goes")
    recording = together([read_recording(each) for each in (file, *more)])
    gap = _analysed(recording, seed)
    proposal = next_poses = None
    if next_plan is not None:
        from loopcal.next_poses import proposed, write_next  # slow to import

        proposal = proposed(gap, next_for)
        next_poses = None if proposal is None or proposal.plan is None else str(next_plan)
    grown = None if rig_out is None or not gap.effects else grown_rig(recording.rig_toml, gap)
    if json_file == _STANDARD_OUTPUT:
        json.dump(gap_json(gap, next_poses), sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
    elif json_file is not None:
        write_json(gap_json(gap, next_poses), json_file)
    if report is not None:
        from solver.report.gap_report import write_gap_report

        with err.status("writing the report"):
            write_gap_report(gap, report, recording=recording, seed=seed, next_poses=next_poses)
    console = err if json_file == _STANDARD_OUTPUT else out
    show(gap, console)
    if proposal is not None and next_plan is not None:
        write_next(recording.rig, proposal, next_plan, console)
    elif next_plan is not None:
        console.print(
            f"No rivals are left to be told apart, so '{next_plan}' was not written; "
            "--next-for NAME@WHERE plans for an effect that you suspect.",
            markup=False,
            soft_wrap=True,
        )
    if rig_out is not None:
        create(rig_out, grown if grown is not None else grown_rig(recording.rig_toml, gap))
    return gap.verdict is not Verdict.UNKNOWN


def _analysed(recording: Recording, seed: int) -> Gap:
    """The analysis, with a bar on the terminal."""
    with bar("reading") as show:
        return analyse(recording, seed=seed, progress=show)


def show(gap: Gap, console: Console) -> None:
    """Print the answer: the verdict, what it rests on, what it leaves open, what to do."""

    def say(text: str) -> None:
        console.print(text, markup=False, soft_wrap=True)

    def head(text: str) -> None:
        console.print(f"\n{text}", style="bold", markup=False)

    console.print(Text(words.headline(gap), style=f"bold {_STYLE[gap.verdict]}"), soft_wrap=True)
    for effect in gap.effects:
        head(words.called(effect.name, effect.where))
        say(f"size: {words.in_full(effect)}")
        say(f"cannot be told from: {words.rivals(effect)}")
        say(f"evidence: {words.evidence(effect)}")
    head("Gap")
    say(words.gap_closed(gap))
    for reason in gap.reasons:
        say(reason)
    for caution in gap.cautions:
        say(f"Caution: {caution}")
    head("Smallest sizes that this recording would have shown, in nine cases of ten")
    console.print(_limits(gap))
    open_ones = words.untested(gap)
    if open_ones:
        head("Could not be tested")
        for each in open_ones:
            say(f"{each.name} ({each.at}): {each.reason}")
    head("What to do next")
    for line in words.advice(gap):
        say(line)


def _limits(gap: Gap) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold", show_header=True)
    for heading in ("effect", "best at", "", "worst at", ""):
        table.add_column(heading, justify="right" if not heading else "left", no_wrap=True)
    for each in words.limits_by_effect(gap.limits):
        row = [each.name, each.best.where, words.amount(each.best.size, each.best.unit)]
        if each.places > 1:
            row += [each.worst.where, words.amount(each.worst.size, each.worst.unit)]
        table.add_row(*row)
    return table
