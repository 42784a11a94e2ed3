"""Verbs at the bench: plan a session, run virtual devices, capture, calibrate one sensor, and the demo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from loopcal.commands.options import (
    HideOption,
    PortOption,
    RecordingOutput,
    RigArgument,
    SeedOption,
    TruthOption,
    ports_by_name,
)
from loopcal.console import explained
from loopcal.files import in_a_folder


def plan(
    rig: RigArgument,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from", metavar="FILE", help="Plan with the values of a result file or recording."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="PLAN",
            help="Plan file to write, for capture.",
            callback=in_a_folder,
        ),
    ] = None,
    poses: Annotated[
        int | None,
        typer.Option("--poses", min=1, help="Distinct poses, in place of the plan's own number."),
    ] = None,
    criterion: Annotated[
        str, typer.Option("--criterion", help="sigma_L (default), determinant, trace or condition.")
    ] = "sigma_L",
) -> None:
    """Plan a session: drives, poses, order, and the standard errors it will reach."""
    from loopcal.planning import run_plan

    with explained():
        run_plan(rig, source=source, output=output, poses=poses, criterion=criterion)


def sim(
    rig: RigArgument,
    port: PortOption = None,
    hide: HideOption = None,
    seed: SeedOption = 1,
    truth: TruthOption = None,
    faults: Annotated[
        Path | None,
        typer.Option(
            "--faults",
            metavar="SCRIPT",
            help="Let happen what a fault script says, such as: at 3 s unplug wrist-adc for 2 s",
        ),
    ] = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="Take lines of a fault script from the standard input too."),
    ] = False,
) -> None:
    """Run the rig's devices virtually, on real ports, until Ctrl-C; with faults, if you like."""
    from loopcal.bench import run_sim

    with explained():
        run_sim(
            rig,
            ports_by_name(port),
            tuple(hide or ()),
            seed,
            truth,
            script=faults,
            live=live,
        )


def capture(
    rig: RigArgument,
    output: RecordingOutput,
    plan: Annotated[
        Path | None,
        typer.Option(
            "--plan", metavar="PLAN", help="Plan file to execute in place of the rig's own."
        ),
    ] = None,
    poses: Annotated[
        int | None,
        typer.Option("--poses", min=1, help="Distinct poses, in place of the plan's own number."),
    ] = None,
    port: PortOption = None,
    arm: Annotated[
        bool,
        typer.Option(
            "--arm", help="Arm real drives without asking. Virtual drives need no arming."
        ),
    ] = False,
    arm_for: Annotated[
        float | None,
        typer.Option(
            "--arm-for",
            metavar="SECONDS",
            min=1.0,
            help="How long an arming lasts, unless a line on standard input (Enter) renews it; then the "
            "session goes safe. By default arming_s of the rig's interlocks, for real drives only.",
        ),
    ] = None,
    operator: Annotated[str, typer.Option(help="Who runs the session, for the record.")] = "",
    notes: Annotated[str, typer.Option(help="Remarks, for the record.")] = "",
    limit: Annotated[
        float | None,
        typer.Option("--limit", metavar="SECONDS", help="End the session after this time."),
    ] = None,
    rotate_mb: Annotated[
        float | None,
        typer.Option(
            "--rotate-mb", metavar="MB", help="Go on in a new file (run.002.mcap) at this size."
        ),
    ] = None,
    rotate_s: Annotated[
        float | None,
        typer.Option("--rotate-s", metavar="SECONDS", help="Go on in a new file after this time."),
    ] = None,
    fsync: Annotated[
        Literal["flush", "close", "never"],
        typer.Option(
            "--fsync",
            help="When data is forced to the disk, against power loss: at every flush (4 times a "
            "second), when a file is closed, or whenever the system likes.",
        ),
    ] = "flush",
    reserve_mb: Annotated[
        float,
        typer.Option(
            "--reserve-mb", metavar="MB", min=0, help="End the session when less disk is free."
        ),
    ] = 32.0,
) -> None:
    """Run a capture session and record it. Ctrl-C ends it cleanly."""
    from loopcal.capturing import run_capture
    from recordings.storage import Storage, Sync

    with explained():
        storage = Storage(
            sync=Sync(fsync),
            reserve_bytes=round(reserve_mb * 1e6),
            rotate_bytes=None if rotate_mb is None else round(rotate_mb * 1e6),
            rotate_s=rotate_s,
        )
        ended_well = run_capture(
            rig,
            output,
            plan=plan,
            poses=poses,
            ports=ports_by_name(port),
            arm=arm,
            arm_for_s=arm_for,
            operator=operator,
            notes=notes,
            limit_s=limit,
            storage=storage,
        )
    if not ended_well:
        raise typer.Exit(1)


def bench_calibrate(
    rig: RigArgument,
    channel: Annotated[str, typer.Argument(metavar="CHANNEL", help="The rig's channel.")],
    table: Annotated[
        Path,
        typer.Argument(
            metavar="TABLE",
            help="CSV with the columns displacement_mm (or _m, or angle_deg, angle_rad) and counts.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="RIG",
            help="Write the rig with the result in it.",
            callback=in_a_folder,
        ),
    ] = None,
) -> None:
    """Calibrate one sensor against known displacements: gain, zero, linearity, noise."""
    from loopcal.bench_calibrating import run_bench_calibrate

    with explained():
        run_bench_calibrate(rig, channel, table, output)


def demo(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FOLDER", help="Where recordings and reports go."),
    ] = Path("demo-output"),
) -> None:
    """Both papers' mechanisms end to end: virtual devices, capture, solve, report."""
    from loopcal.demo import run_demo

    with explained():
        run_demo(output)
