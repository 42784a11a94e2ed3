"""`loopcal blind`: play the grid with a progress bar, write the page, print the table of scores."""

from __future__ import annotations

from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from loopcal.blind.grid import cases, short_cases
from loopcal.blind.page import PAGE, shown, wanted, write_page
from loopcal.blind.run import ANSWERS, SEALED, read, run
from loopcal.blind.score import Score, outcomes
from loopcal.console import err, fail, out
from sim_devices.plant.effects.registry import EFFECT_KINDS, OUTSIDER_KINDS


def run_blind(
    folder: Path,
    *,
    short: bool,
    runs: int,
    jobs: int,
    seed: int,
    only: str | None,
    resume: bool,
) -> bool:
    """Play what ``folder`` does not have yet and score all that it has; whether every score is met."""
    known = (*EFFECT_KINDS, *OUTSIDER_KINDS, "null", "double", "outsider")
    if only is not None and only not in known:
        fail(f"--only is '{only}', expected one of: {', '.join(known)}")
    if (folder / SEALED).exists() and not resume:
        fail(f"'{folder}' holds a benchmark already; choose another folder, or go on with --resume")
    grid = short_cases(seed) if short else cases(seed, runs=runs, only=only)
    with Progress(
        TextColumn("blind"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=err,
    ) as bar:
        task = bar.add_task("blind", total=len(grid))
        run(
            grid,
            folder,
            jobs=jobs,
            progress=lambda done, of: bar.update(task, completed=done, total=of),
        )
    sealed = read(folder / SEALED)
    left_out = [line for line in sealed if line["left_out"]]
    table = write_page(outcomes(sealed, read(folder / ANSWERS)), left_out, folder)
    _show(table, len(left_out))
    out.print(f"wrote {folder / PAGE}", markup=False)
    return all(score.met is not False for score in table)


def _show(scores: tuple[Score, ...], left_out: int) -> None:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column, justify in (("score", "left"), ("reached", "right"), ("cases", "right")):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    table.add_column("to reach")
    for score in scores:
        style = {None: "", True: "green", False: "red"}[score.met]
        of = "" if score.rate is None else str(score.rate.of)
        table.add_row(score.name, shown(score), of, wanted(score), style=style)
    out.print(table)
    out.print(f"cases that could not be made: {left_out}")
