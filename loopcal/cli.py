"""The `loopcal` command: every verb, its options, and nothing else.

Each verb reads its input, calls one room, and prints what came back. The file is long because
all verbs and their help stand together, so that the command reads as one table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from loopcal.console import explained, out

app = typer.Typer(
    name="loopcal",
    help="A robot calibrates itself from its own joint sensors, by closing a kinematic loop.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="rich",
)
rig_app = typer.Typer(help="Look at rig descriptions.", no_args_is_help=True)
app.add_typer(rig_app, name="rig")

RigArgument = Annotated[
    str,
    typer.Argument(metavar="RIG", help="A rig file, or the name of a bundled rig (arm, shoulder)."),
]
PortOption = Annotated[
    list[str] | None,
    typer.Option(
        "--port", metavar="NAME=PATH", help="Use PATH for the rig's port NAME. May be repeated."
    ),
]
HideOption = Annotated[
    list[str] | None,
    typer.Option(
        "--hide",
        metavar="NAME@WHERE=SIZE",
        help="Hide an effect in nature, such as nonlinearity@q6=2%, or 'random'. May be repeated.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of all that is random.")]
TruthOption = Annotated[
    Path | None,
    typer.Option("--truth", metavar="FILE", help="Write what nature really is to FILE."),
]


@rig_app.command("check")
def rig_check(rig: RigArgument) -> None:
    """Show a rig's mobility, sensors and parameters, and find mistakes before hardware is touched."""
    from loopcal.rig_view import show_check

    with explained():
        mistakes = show_check(rig)
    if mistakes:
        raise typer.Exit(1)


@rig_app.command("list")
def rig_list() -> None:
    """List the bundled rigs."""
    from recordings.rig import bundled_rigs, load_rig

    for name in bundled_rigs():
        out.print(f"{name:12} {load_rig(name).title}", markup=False)


@rig_app.command("show")
def rig_show(rig: RigArgument) -> None:
    """Print a rig's file, as a start for your own."""
    from recordings.rig import rig_text

    with explained():
        out.file.write(rig_text(rig)[0])


@rig_app.command("from-urdf")
def rig_from_urdf(
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
        write_rig(urdf, tip, constraint, tuple(fixture or ("fixture",)), doubts, output)
    out.print(f"wrote {output}", markup=False)


@app.command("export-urdf")
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


@app.command("import")
def import_(
    rig: RigArgument,
    tables: Annotated[
        list[str],
        typer.Argument(
            metavar="TABLE.csv...",
            help="Tables of poses, or FIXTURE=TABLE.csv for one of a fixture.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Recording to write.")
    ],
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


@app.command()
def sim(
    rig: RigArgument,
    port: PortOption = None,
    hide: HideOption = None,
    seed: SeedOption = 1,
    truth: TruthOption = None,
) -> None:
    """Run the rig's devices virtually, on real ports, until Ctrl-C."""
    from loopcal.bench import run_sim

    with explained():
        run_sim(rig, _ports(port), tuple(hide or ()), seed, truth)


@app.command()
def simulate(
    rig: RigArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Recording to write.")
    ],
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


@app.command()
def capture(
    rig: RigArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Recording to write.")
    ],
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
    operator: Annotated[str, typer.Option(help="Who runs the session, for the record.")] = "",
    notes: Annotated[str, typer.Option(help="Remarks, for the record.")] = "",
    limit: Annotated[
        float | None,
        typer.Option("--limit", metavar="SECONDS", help="End the session after this time."),
    ] = None,
) -> None:
    """Run a capture session and record it. Ctrl-C ends it cleanly."""
    from loopcal.capturing import run_capture

    with explained():
        ended_well = run_capture(
            rig,
            output,
            plan=plan,
            poses=poses,
            ports=_ports(port),
            arm=arm,
            operator=operator,
            notes=notes,
            limit_s=limit,
        )
    if not ended_well:
        raise typer.Exit(1)


@app.command()
def solve(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A loopcal recording.")],
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
        Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write an HTML report.")
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


@app.command()
def gap(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A loopcal recording.")],
    more: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="MORE", help="Further recordings of the same rig, analysed with it."
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="PAGE", help="Write an HTML report.")
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="PATH", help="Write the answer as JSON; - prints it."),
    ] = None,
    rig_out: Annotated[
        Path | None,
        typer.Option("--rig-out", metavar="RIG", help="Write the rig with what is missing in it."),
    ] = None,
    next_plan: Annotated[
        Path | None,
        typer.Option(
            "--next", metavar="PLAN", help="Write a plan of the poses that tell the rivals apart."
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


@app.command()
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


@app.command()
def apply(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A result file, from solve --json.")
    ],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording of the same rig.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="CSV", help="Write the poses as a table."),
    ] = None,
    rig_out: Annotated[
        Path | None, typer.Option("--rig-out", metavar="RIG", help="Write the calibrated rig.")
    ] = None,
    corrections: Annotated[
        Path | None,
        typer.Option(
            "--corrections", metavar="JSON", help="Write gain and offset of every channel."
        ),
    ] = None,
) -> None:
    """Use a result: readings become endpoint or plate poses with their uncertainty."""
    from loopcal.applying import run_apply

    with explained():
        run_apply(result, file, output=output, rig_out=rig_out, corrections=corrections)


@app.command()
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


@app.command("bench-calibrate")
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
        typer.Option("-o", "--output", metavar="RIG", help="Write the rig with the result in it."),
    ] = None,
) -> None:
    """Calibrate one sensor against known displacements: gain, zero, linearity, noise."""
    from loopcal.bench_calibrating import run_bench_calibrate

    with explained():
        run_bench_calibrate(rig, channel, table, output)


@rig_app.command("choose")
def rig_choose(
    rig: RigArgument,
    condition: Annotated[
        float, typer.Option("--condition", min=1.0, help="Largest condition number to accept.")
    ] = 1000.0,
) -> None:
    """Choose which parameters to identify: from all, the least observable is held, step by step."""
    from loopcal.rig_view import show_choice

    with explained():
        show_choice(rig, condition)


@rig_app.command("sensitivity")
def rig_sensitivity(
    rig: RigArgument,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="At the values of a result file or recording."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write a page with the picture.")
    ] = None,
) -> None:
    """Show how far an error of each parameter puts the endpoint or plate from where it is."""
    from loopcal.rig_view import show_sensitivity

    with explained():
        show_sensitivity(rig, source, report)


@app.command()
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
        typer.Option("-o", "--output", metavar="PLAN", help="Plan file to write, for capture."),
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


def _ports(given: list[str] | None) -> dict[str, str]:
    ports = {}
    for item in given or ():
        name, equals, path = item.partition("=")
        if not (name and equals and path):
            raise typer.BadParameter(f"'{item}' is not NAME=PATH", param_hint="--port")
        ports[name] = path
    return ports


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        out.print(f"loopcal {installed('loopcal')}", markup=False)
        raise typer.Exit


def main() -> None:
    """Entry point of the `loopcal` command."""
    app()
