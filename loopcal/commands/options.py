"""Arguments and options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
RecordingArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A loopcal recording.")]
RecordingOutput = Annotated[
    Path, typer.Option("-o", "--output", metavar="FILE", help="Recording to write.")
]


def ports_by_name(given: list[str] | None) -> dict[str, str]:
    """NAME=PATH items as a mapping.

    Raises:
        typer.BadParameter: an item is not NAME=PATH.
    """
    ports = {}
    for item in given or ():
        name, equals, path = item.partition("=")
        if not (name and equals and path):
            raise typer.BadParameter(f"'{item}' is not NAME=PATH", param_hint="--port")
        ports[name] = path
    return ports
