"""`loopcal export`: the readings of a recording as a table, CSV or Parquet.

Owns the two formats of file and the order of their columns; the rows are made by
`loopcal.export_rows`, and written as they come. Parquet needs pyarrow, which is optional:
it is larger than all that this program otherwise needs.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.console import fail, out
from loopcal.export_rows import Rows, fixtures, rows
from loopcal.progress import bar
from recordings.reader import read_recording
from recordings.recording import Recording

COLUMNS = (
    "channel", "time_ns", "device_time_ns", "sequence", "flags", "raw_counts",
    "value_rad", "value_m", "pose", "visit", "fixture",
)  # fmt: skip
"""Names of the columns. A channel fills one of the two values; of the last three there are
some only within dwells. Where nothing is to be said the field is empty, null in Parquet."""

_SUFFIXES = (".csv", ".parquet")


def run_export(file: Path, output: Path) -> None:
    """Write the readings of ``file`` to ``output``; what it is, its suffix says."""
    suffix = output.suffix.lower()
    if suffix not in _SUFFIXES:
        fail(f"'{output}' ends in '{suffix}', expected one of: {', '.join(_SUFFIXES)}")
    write = _csv if suffix == ".csv" else _parquet()
    if output.exists():
        fail(f"'{output}' exists already; choose another name, nothing was overwritten")
    with bar("reading") as show:
        recording = read_recording(file)
        total = sum(map(len, recording.readings.values()))
        write(recording, output, _shown(rows(recording), total, show))
    out.print(f"{total:,} readings written to {output}", markup=False, soft_wrap=True)


Write = Callable[[Recording, Path, Iterator[Rows]], None]


def _csv(recording: Recording, output: Path, parts: Iterator[Rows]) -> None:
    names = [channel.name for channel in recording.rig.channels]
    held = [*fixtures(recording), ""]
    with _created(output), output.open("x", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for part in parts:
            count = len(part.channel)
            columns: dict[str, Sequence[object]] = {
                name: [None] * count if column is None else column.tolist()
                for name, column in part.numbers.items()
            }
            columns["channel"] = [names[number] for number in part.channel.tolist()]
            columns["fixture"] = [held[number] for number in part.fixture.tolist()]
            writer.writerows(zip(*(columns[name] for name in COLUMNS), strict=True))


def _parquet() -> Write:
    """The Parquet writer; fails in words where pyarrow, which is optional, is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        fail("Parquet needs pyarrow: pip install 'loopcal[parquet]'; or export to .csv")
    names = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    kinds = {
        "channel": names,
        "time_ns": pyarrow.int64(),
        "device_time_ns": pyarrow.int64(),
        "sequence": pyarrow.uint32(),
        "flags": pyarrow.uint32(),
        "raw_counts": pyarrow.int64(),
        "value_rad": pyarrow.float64(),
        "value_m": pyarrow.float64(),
        "pose": pyarrow.int32(),
        "visit": pyarrow.int32(),
        "fixture": names,
    }

    def write(recording: Recording, output: Path, parts: Iterator[Rows]) -> None:
        channels = pyarrow.array([channel.name for channel in recording.rig.channels])
        held = pyarrow.array(fixtures(recording), pyarrow.string())
        session = recording.session.session_id
        about = {"loopcal.rig.toml": recording.rig_toml, "loopcal.session_id": session}
        schema = pyarrow.schema([(name, kinds[name]) for name in COLUMNS], about)

        def words(numbers: NDArray[np.int64], known: Any) -> Any:
            indices = pyarrow.array(numbers, pyarrow.int32(), mask=numbers < 0)
            return pyarrow.DictionaryArray.from_arrays(indices, known)

        def column(name: str, part: Rows) -> Any:
            if name in ("channel", "fixture"):
                chosen, known = (
                    (part.channel, channels) if name == "channel" else (part.fixture, held)
                )
                return words(chosen, known)
            values = part.numbers[name]
            if values is None:
                return pyarrow.nulls(len(part.channel), kinds[name])
            mask = np.ma.getmaskarray(values)
            return pyarrow.array(values.data, mask=mask).cast(kinds[name])

        with (
            _created(output),
            output.open("xb") as file,
            pyarrow.parquet.ParquetWriter(file, schema) as writer,
        ):
            for part in parts:
                columns = [column(name, part) for name in COLUMNS]
                writer.write_table(pyarrow.Table.from_arrays(columns, schema=schema))

    return write


@contextmanager
def _created(output: Path) -> Iterator[None]:
    """A new file: taken away again where it could not be written to its end."""
    try:
        yield
    except FileExistsError:
        fail(f"'{output}' exists already; choose another name, nothing was overwritten")
    except OSError as error:
        output.unlink(missing_ok=True)
        fail(f"cannot write '{output}': {error.strerror or error}")
    except BaseException:
        output.unlink(missing_ok=True)
        raise


def _shown(parts: Iterator[Rows], total: int, show: Callable[[str, float], None]) -> Iterator[Rows]:
    done = 0
    for part in parts:
        yield part
        done += len(part.channel)
        show("writing", done / max(total, 1))
