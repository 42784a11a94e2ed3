"""`loopcal gap --next`: the plan of the poses that tell most, and on the terminal what they will tell."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from loopcal.console import err
from loopcal.files import create
from loopcal.planning import plan_lines
from recordings.rig import Rig
from solver.gap.elsewise import elsewise
from solver.gap.next_poses import NextPoses, propose
from solver.gap.result import Gap


def proposed(gap: Gap, wanted: str | None) -> NextPoses | None:
    """Poses that tell apart what ``gap`` leaves open; None where it leaves nothing open.

    Args:
        gap: the answer.
        wanted: an effect ``NAME@WHERE`` that is to be seen if it is there, or None.

    Raises:
        MechanismError: ``wanted`` could not be looked for, or nothing can be reached safely.
    """
    if wanted is None and not any(named.rivals for named in gap.search.named):
        return None
    with err.status("looking for the next poses"):
        return propose(gap.search, gap.table, wanted=wanted)


def write_next(rig: Rig, proposal: NextPoses, path: Path, console: Console) -> None:
    """Say what the poses of ``proposal`` will tell, and write their plan, if there is one."""
    show_next(proposal, console)
    if proposal.plan is None:
        return
    create(path, next_text(rig, proposal))
    console.print(
        f"wrote {path}: capture it with `--plan {path}`, then analyse both recordings together, "
        "`loopcal gap FILE MORE`",
        markup=False,
        soft_wrap=True,
    )


def next_text(rig: Rig, proposal: NextPoses) -> str:
    """The plan file: TOML with one table, ``[plan]``."""
    assert proposal.plan is not None  # callers look first
    told = sorted(
        {f"{p.effect} from {p.other or 'nothing'}" for p in proposal.pairs if p.separable}
    )
    lines = [
        f"# Poses of rig '{rig.name}' that tell apart what a recording left open:",
        *(f"#   {pair}" for pair in told),
        f"# Chance that they decide: {proposal.chance:.0%}.",
        *(f"# No reachable pose tells apart: {', '.join(group)}." for group in proposal.twins),
        "",
        *plan_lines(rig, proposal.plan, proposal.coordinates, proposal.coordinate_names),
    ]
    return "\n".join(lines) + "\n"


def show_next(proposal: NextPoses, console: Console) -> None:
    """Print how much the separation of every pair grows, and what else than poses would help."""
    console.print("\nNext poses", style="bold", markup=False)
    if proposal.plan is None:
        console.print("No feasible pose tells them apart.", markup=False)
    else:
        console.print(
            f"{len(proposal.coordinates)} poses, {len(proposal.visited.stops)} stops; chance that they decide: "
            f"{proposal.chance:.0%}",
            markup=False,
        )
        table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
        for heading, justify in (
            ("if this is at work", "left"),
            ("not this", "left"),
            ("log evidence added", "right"),
            ("chance", "right"),
            ("random poses for as much", "right"),
        ):
            table.add_column(heading, justify="right" if justify == "right" else "left")
        for pair in proposal.pairs:
            if pair.separable:
                many = "> 1000" if pair.random_poses > 1000 else f"{pair.random_poses:.0f}"
                table.add_row(
                    pair.effect,
                    pair.other or "nothing",
                    f"{pair.evidence:.3g}",
                    f"{pair.chance:.0%}",
                    many,
                )
        console.print(table)
    for group in proposal.twins:
        console.print(
            f"Whatever poses are captured, these stay together: {', '.join(group)}.",
            markup=False,
            soft_wrap=True,
        )
    for each in elsewise(proposal):
        console.print(each.text, markup=False, soft_wrap=True)
