"""Verbs about rig descriptions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopcal.commands.options import RigArgument
from loopcal.console import explained, out
from loopcal.files import in_a_folder


def check(rig: RigArgument) -> None:
    """Show a rig's mobility, sensors and parameters, and find mistakes before hardware is touched."""
    from loopcal.rig_view import show_check

    with explained():
        mistakes = show_check(rig)
    if mistakes:
        raise typer.Exit(1)


def list_() -> None:
    """List the bundled rigs."""
    from recordings.rig import bundled_rigs, load_rig

    for name in bundled_rigs():
        out.print(f"{name:12} {load_rig(name).title}", markup=False)


def show(rig: RigArgument) -> None:
    """Print a rig's file, as a start for your own."""
    from recordings.rig import rig_text

    with explained():
        out.file.write(rig_text(rig)[0])


def from_urdf(
    urdf: Annotated[Path, typer.Argument(metavar="ARM.urdf", help="The arm as a URDF.")],
    tip: Annotated[str, typer.Option("--tip", metavar="LINK", help="The link that is held.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RIG", help="Rig to write.")],
    constraint: Annotated[
        str, typer.Option("--constraint", help="rigid, hinge, slider, ball or plane.")
    ] = "ball",
    fixture: Annotated[
        list[str] | None,
        typer.Option(
            "--fixture", metavar="NAME", help="A place that holds the tip. May be repeated."
        ),
    ] = None,
    length_mm: Annotated[
        float,
        typer.Option(min=0.0, help="Uncertainty of each length of a joint's origin; 0: exact."),
    ] = 2.0,
    angle_mrad: Annotated[
        float,
        typer.Option(min=0.0, help="Uncertainty of each angle of a joint's origin; 0: exact."),
    ] = 10.0,
    encoder_mrad: Annotated[
        float, typer.Option(min=0.0, help="Uncertainty of each joint's zero besides; 0: exact.")
    ] = 0.0,
    noise_mrad: Annotated[float, typer.Option(min=0.0, help="Noise of one joint reading.")] = 0.2,
    gravity_compensated: Annotated[
        bool,
        typer.Option(
            "--gravity-compensated",
            help="Each joint carries the weight that it moves while the arm stands, as in hand guiding.",
        ),
    ] = False,
    exact_tip: Annotated[
        bool, typer.Option("--exact-tip", help="The transform to the tip is known exactly.")
    ] = False,
) -> None:
    """Start a rig from a URDF: the chain from its root to a link, ready to calibrate."""
    from loopcal.arms import write_rig
    from recordings.urdf import Doubts

    doubts = Doubts(
        length_m=1e-3 * length_mm,
        angle_rad=1e-3 * angle_mrad,
        encoder_rad=1e-3 * encoder_mrad,
        noise_rad=1e-3 * noise_mrad,
        tip=not exact_tip,
    )
    with explained():
        write_rig(
            urdf,
            tip,
            constraint,
            tuple(fixture or ("fixture",)),
            doubts,
            output,
            gravity_compensated=gravity_compensated,
        )
    out.print(f"wrote {output}", markup=False)


def choose(
    rig: RigArgument,
    condition: Annotated[
        float, typer.Option("--condition", min=1.0, help="Largest condition number to accept.")
    ] = 1000.0,
) -> None:
    """Choose which parameters to identify: from all, the least observable is held, step by step."""
    from loopcal.rig_view import show_choice

    with explained():
        show_choice(rig, condition)


def sensitivity(
    rig: RigArgument,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="At the values of a result file or recording."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", metavar="FILE", help="Write a page with the picture.", callback=in_a_folder
        ),
    ] = None,
) -> None:
    """Show how far an error of each parameter puts the endpoint or plate from where it is."""
    from loopcal.rig_view import show_sensitivity

    with explained():
        show_sensitivity(rig, source, report)


def export_urdf(
    result: Annotated[Path, typer.Argument(metavar="RESULT.json", help="From solve --json.")],
    urdf: Annotated[
        Path, typer.Argument(metavar="ARM.urdf", help="The URDF that the rig was made from.")
    ],
    tip: Annotated[str, typer.Option("--tip", metavar="LINK", help="The link that was held.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="URDF to write.")],
) -> None:
    """Write a URDF whose joint origins are the calibrated ones; all else stays as it was."""
    from loopcal.arms import write_calibrated

    with explained():
        write_calibrated(result, urdf, tip, output)
    out.print(f"wrote {output}", markup=False)
