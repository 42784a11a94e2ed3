"""Verbs that answer from recordings: solve, apply a result, name what is missing, and score the naming."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from loopcal.commands.options import RecordingArgument, SeedOption
from loopcal.console import explained
from loopcal.files import in_a_folder


def solve(
    file: RecordingArgument,
    poses: Annotated[
        int, typer.Option("-n", "--poses", min=1, help="How many poses to use: the best of all.")
    ] = 50,
    method: Annotated[
        str | None, typer.Option("--method", help="ml (default), hinge, or multi-loop.")
    ] = None,
    robust: Annotated[
        Literal["none", "huber", "cauchy"],
        typer.Option("--robust", help="Weigh down poses that noise cannot explain (ml only)."),
    ] = "none",
    priors: Annotated[
        bool,
        typer.Option("--priors", help="Let the rig's stated uncertainties take part (ml only)."),
    ] = False,
    criterion: Annotated[
        str,
        typer.Option(
            "--criterion",
            help="By which poses are chosen: sigma_L (default), determinant, trace or condition.",
        ),
    ] = "sigma_L",
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write the result as JSON.", callback=in_a_folder
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", metavar="FILE", help="Write an HTML report.", callback=in_a_folder
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="FILE", help="Show a truth file beside the estimate."),
    ] = None,
) -> None:
    """Calibrate: recording in, parameters with uncertainty out."""
    from loopcal.solving import run_solve

    with explained():
        converged = run_solve(
            file,
            poses=poses,
            method=method,
            loss=robust,
            use_priors=priors,
            criterion=criterion,
            json_file=json_file,
            report=report,
            truth=truth,
        )
    if not converged:
        raise typer.Exit(1)


def apply(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A result file, from solve --json.")
    ],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording of the same rig.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="CSV",
            help="Write the poses as a table.",
            callback=in_a_folder,
        ),
    ] = None,
    rig_out: Annotated[
        Path | None,
        typer.Option(
            "--rig-out", metavar="RIG", help="Write the calibrated rig.", callback=in_a_folder
        ),
    ] = None,
    corrections: Annotated[
        Path | None,
        typer.Option(
            "--corrections",
            metavar="JSON",
            help="Write gain and offset of every channel.",
            callback=in_a_folder,
        ),
    ] = None,
) -> None:
    """Use a result: readings become endpoint or plate poses with their uncertainty."""
    from loopcal.applying import run_apply

    with explained():
        run_apply(result, file, output=output, rig_out=rig_out, corrections=corrections)


def gap(
    file: RecordingArgument,
    more: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="MORE", help="Further recordings of the same rig, analysed with it."
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", metavar="PAGE", help="Write an HTML report.", callback=in_a_folder
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json",
            metavar="PATH",
            help="Write the answer as JSON; - prints it.",
            callback=in_a_folder,
        ),
    ] = None,
    rig_out: Annotated[
        Path | None,
        typer.Option(
            "--rig-out",
            metavar="RIG",
            help="Write the rig with what is missing in it.",
            callback=in_a_folder,
        ),
    ] = None,
    next_plan: Annotated[
        Path | None,
        typer.Option(
            "--next",
            metavar="PLAN",
            help="Write a plan of the poses that tell the rivals apart.",
            callback=in_a_folder,
        ),
    ] = None,
    next_for: Annotated[
        str | None,
        typer.Option(
            "--next-for", metavar="NAME@WHERE", help="Plan for seeing this effect, if it is there."
        ),
    ] = None,
    seed: SeedOption = 1,
) -> None:
    """Name what the rig lacks: which effect, where, how big, and how sure that is.

    Exit code 1 says that something is missing that is none of the known effects.
    """
    from loopcal.gap import run_gap

    with explained():
        answered = run_gap(
            file,
            seed=seed,
            json_file=json_file,
            report=report,
            rig_out=rig_out,
            more=tuple(more or ()),
            next_plan=next_plan,
            next_for=next_for,
        )
    if not answered:
        raise typer.Exit(1)


def blind(
    output: Annotated[
        Path,
        typer.Option("--out", metavar="FOLDER", help="Where cases, scores and pictures go."),
    ] = Path("blind-output"),
    short: Annotated[
        bool, typer.Option("--short", help="Some twenty cases, two minutes: what the tests run.")
    ] = False,
    runs: Annotated[
        int, typer.Option("--runs", min=1, help="Times that the whole grid is played.")
    ] = 1,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Processes at work.")] = 2,
    seed: SeedOption = 1,
    only: Annotated[
        str | None,
        typer.Option(
            "--only",
            metavar="EFFECT",
            help="Cases of one effect only; or of one kind: null, double, outsider.",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where a run in the same folder was ended.")
    ] = False,
) -> None:
    """Hide effects in nature, analyse the recordings blindly, and score the answers.

    The whole grid takes hours. Exit code 1 says that a score falls short.
    """
    from loopcal.blind.command import run_blind

    with explained():
        met = run_blind(
            output, short=short, runs=runs, jobs=jobs, seed=seed, only=only, resume=resume
        )
    if not met:
        raise typer.Exit(1)
