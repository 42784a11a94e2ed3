"""The `loopcal` command: every verb with what runs it, as one table."""

from __future__ import annotations

from typing import Annotated

import typer

from loopcal.commands import answers, making, recordings, rigs, sessions
from loopcal.console import out

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

rig_app.command("check")(rigs.check)
rig_app.command("list")(rigs.list_)
rig_app.command("show")(rigs.show)
rig_app.command("from-urdf")(rigs.from_urdf)
rig_app.command("choose")(rigs.choose)
rig_app.command("sensitivity")(rigs.sensitivity)

app.command("demo")(sessions.demo)
app.command("plan")(sessions.plan)
app.command("sim")(sessions.sim)
app.command("capture")(sessions.capture)
app.command("bench-calibrate")(sessions.bench_calibrate)

app.command("simulate")(making.simulate)
app.command("import")(making.import_)

app.command("solve")(answers.solve)
app.command("apply")(answers.apply)
app.command("info")(recordings.info)
app.command("doctor")(recordings.doctor)
app.command("recover")(recordings.recover)
app.command("export")(recordings.export)
app.command("export-urdf")(rigs.export_urdf)
app.command("gap")(answers.gap)
app.command("blind")(answers.blind)


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
