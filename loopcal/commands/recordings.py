"""Verbs for recordings as files: what is in one, how well it is, repair, and other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopcal.commands.options import RecordingArgument
from loopcal.console import explained


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

    A row a reading, in order of host time: channel, time_ns (host, since 1970), device_time_ns,
    sequence, flags, raw_counts, the value they have by the rig's gain and offset (value_rad or
    value_m), and pose, visit and fixture within dwells. Corrected values: `loopcal apply`.
    """
    from loopcal.exporting import run_export

    with explained():
        run_export(file, output)
