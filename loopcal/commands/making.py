"""Verbs that make recordings without devices: from tables taken elsewhere, and by simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopcal.commands.options import (
    HideOption,
    RecordingOutput,
    RigArgument,
    SeedOption,
    TruthOption,
)
from loopcal.console import explained, out


def import_(
    rig: RigArgument,
    tables: Annotated[
        list[str],
        typer.Argument(
            metavar="TABLE.csv...",
            help="Tables of poses, or FIXTURE=TABLE.csv for one of a fixture.",
        ),
    ],
    output: RecordingOutput,
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns",
            metavar="q1_rad,q2_rad,...",
            help="Column names of tables that have no header line.",
        ),
    ] = None,
) -> None:
    """Turn tables of readings taken elsewhere (<channel>_<unit>, a pose a row) into a recording."""
    from loopcal.arms import table_of
    from recordings.rig import parse_rig, rig_text
    from recordings.tables import import_tables

    with explained():
        text, source = rig_text(rig)
        rows = import_tables(
            parse_rig(text, source),
            text,
            [table_of(item) for item in tables],
            output,
            columns=None if columns is None else [name.strip() for name in columns.split(",")],
        )
    out.print(f"wrote {output}: {rows} poses", markup=False)


def simulate(
    rig: RigArgument,
    output: RecordingOutput,
    poses: Annotated[
        int | None,
        typer.Option("--poses", min=1, help="Distinct poses, in place of the plan's own number."),
    ] = None,
    seed: SeedOption = 1,
    hide: HideOption = None,
    truth: TruthOption = None,
    plan: Annotated[
        Path | None,
        typer.Option("--plan", metavar="PLAN", help="Plan file to play in place of the rig's own."),
    ] = None,
) -> None:
    """Write the recording that a capture of the rig would, without wires and without waiting."""
    from recordings.rig import load_plan, parse_rig, rig_text
    from sim_devices.simulate import simulate as run

    with explained():
        text, source = rig_text(rig)
        run(
            parse_rig(text, source),
            text,
            output,
            poses=poses,
            seed=seed,
            hide=tuple(hide or ()),
            truth_path=truth,
            plan=None if plan is None else load_plan(plan),
        )
    out.print(f"wrote {output}", markup=False)
