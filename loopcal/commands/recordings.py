"""Verbs for recordings as files: what is in one, how well it is, repair, and other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopcal.commands.options import RecordingArgument, RecordingOutput
from loopcal.console import explained

_Files = Annotated[
    list[Path],
    typer.Argument(metavar="FILE...", help="Recordings. The first part stands for all parts."),
]
_Json = Annotated[bool, typer.Option("--json", help="Print it as JSON, for programs.")]


def info(files: _Files, as_json: _Json = False) -> None:
    """Show what a recording is: rig, session, channels, rates, losses, dwells, marks, faults.

    Exit codes, of several files the highest:
    0: whole.
    1: damaged, but readable.
    2: no such file, or another kind of file.
    3: hopeless, nothing of it can be used.
    """
    from loopcal.info import run_info

    with explained():
        code = run_info(files, as_json=as_json)
    if code:
        raise typer.Exit(code)


def doctor(files: _Files, as_json: _Json = False) -> None:
    """Tell what is wrong with a recording, how bad that is, and what to do about it.

    Exit codes, of several files the highest:
    0: whole, and nothing is bad.
    1: damaged but readable, or something is bad.
    2: no such file, or another kind of file.
    3: hopeless, nothing of it can be used.
    """
    from loopcal.doctor import run_doctor

    with explained():
        code = run_doctor(files, as_json=as_json)
    if code:
        raise typer.Exit(code)


def recover(
    file: RecordingArgument,
    output: RecordingOutput,
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="RIG", help="Rig of a recording that has lost its own."),
    ] = None,
) -> None:
    """Write all that can be read of a damaged recording, and of all its parts, to a new one.

    FILE is only read. Exit codes:
    0: it was whole, and is copied.
    1: it was damaged, and is recovered.
    2: no such file, another kind of file, or the output exists.
    3: hopeless, nothing of it can be used; no file is written.
    """
    from loopcal.recovering import run_recover

    with explained():
        code = run_recover(file, output, rig=rig)
    if code:
        raise typer.Exit(code)


def export(
    file: RecordingArgument,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="TABLE", help="Table to write: .csv, or .parquet (pyarrow)."
        ),
    ],
) -> None:
    """Write the readings as a table: CSV, or Parquet with `pip install 'loopcal\\[parquet]'`.

    One row a reading: times, device's counter and flags, raw counts and their value, dwell.
    """
    from loopcal.exporting import run_export

    with explained():
        run_export(file, output)
