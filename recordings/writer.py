"""Writes a recording.

Owns the file from its creation, which never replaces another, to its summary, and keeps
the loss ledger. Reads no clock: every time in the file is the time of an event.
"""

from __future__ import annotations

import contextlib
import struct
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings import codec
from recordings.container import Container
from recordings.errors import RecordingError
from recordings.events import Event, LedgerEntry, ModeCommand, ModeReport, Reading
from recordings.rig import SerialMechanism, parse_rig
from recordings.session import METADATA_NAME, SOFTWARE, Session, to_metadata
from recordings.wire import encode_reading, encode_rows

PROFILE = "loopcal"
RIG_ATTACHMENT = "rig.toml"


@dataclass(frozen=True, slots=True)
class _Account:
    """What the caller knows of one source's losses; totals since the start."""

    expected: int
    dropped_by_device: int
    dropped_by_host: int
    lost_in_gaps: int
    gaps: int


class Writer:
    """A recording being written. A context manager; one thread at a time.

    Args:
        path: file to create.
        rig_toml: the rig description, attached exactly as it is.
        session: who records, when and with what.

    Raises:
        RigError: ``rig_toml`` is not a valid rig; nothing is created.
        RecordingError: the file exists already, or cannot be created.
    """

    def __init__(self, path: str | Path, rig_toml: str, session: Session) -> None:
        self._path = Path(path)
        rig = parse_rig(rig_toml)
        self._channel_names = tuple(channel.name for channel in rig.channels)
        joints = rig.mechanism.places if isinstance(rig.mechanism, SerialMechanism) else ()
        self._joint_names = tuple(joints)
        try:
            self._file = self._path.open("xb")
        except FileExistsError as error:
            raise RecordingError(
                f"'{path}' exists already, and a recording never replaces a file; "
                "choose another name or move it away"
            ) from error
        except OSError as error:
            raise RecordingError(f"cannot create the recording '{path}': {error}") from error
        self._time_ns = session.start_ns
        self._schema_ids: dict[codec.Kind, int] = {}
        self._channel_ids: dict[tuple[codec.Kind, str], int] = {}
        self._received = dict.fromkeys(self._channel_names, 0)
        self._accounts: dict[str, _Account] = {}
        self._kept_by_caller: set[str] = set()
        self._closed = False
        try:
            self._container = Container(self._file, PROFILE, SOFTWARE)
            rig_bytes = rig_toml.encode("utf-8")
            self._container.attach(RIG_ATTACHMENT, "application/toml", rig_bytes, session.start_ns)
            self._container.add_metadata(METADATA_NAME, to_metadata(session))
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def write(self, event: Event) -> None:
        """Record one event.

        A `LedgerEntry` is recorded as it stands, and from then on its source's ledger is
        the caller's to keep.

        Raises:
            RecordingError: its channel or joint is not in the rig, a number does not fit, the
                recording is closed, or the disk failed.
        """
        if isinstance(event, Reading):
            self._append(codec.READING, event.channel, event)
            self._received[event.channel] += 1
            return
        kind = codec.kind_of(event)
        subject = "" if kind.subject is None else str(getattr(event, kind.subject))
        if isinstance(event, ModeCommand | ModeReport) and event.joint not in self._joint_names:
            raise RecordingError(
                f"'{event.joint}' is not a joint of the rig; joints: {_list(self._joint_names)}"
            )
        if isinstance(event, LedgerEntry):
            self._kept_by_caller.add(event.source)
        self._append(kind, subject, event)

    def write_readings(
        self,
        channel: str,
        time_ns: ArrayLike,
        raw: ArrayLike,
        device_time_ns: ArrayLike | None = None,
        sequence: ArrayLike | None = None,
        flags: ArrayLike | None = None,
    ) -> None:
        """Record many readings of one channel; same bytes as one `write` a reading.

        The file holds readings in the order in which they are written. Who has several
        channels writes them in turns of a second or so, so that time runs on in the file.

        Args:
            channel: channel name of the rig.
            time_ns: (n,) host arrival, nanoseconds since the Unix epoch.
            raw: (n,) counts.
            device_time_ns: (n,) time on the device's clock, or None where it has none.
            sequence: (n,) device's sample counter modulo 2**32, or None where it has none.
            flags: (n,) `ReadingFlag` bits, or None for no flags.

        Raises:
            RecordingError: unknown channel, a value that does not fit, closed, or disk failed.
            ValueError: the arrays are not one-dimensional integers of one length.
        """
        columns = {
            "time_ns": _column("time_ns", time_ns, 0, 2**63 - 1),
            "raw": _column("raw", raw, -(2**63), 2**63 - 1),
        }
        if device_time_ns is not None:
            name = "device_time_ns"
            columns[name] = _column(name, device_time_ns, -(2**63), 2**63 - 1)
        if sequence is not None:
            columns["sequence"] = _column("sequence", sequence, 0, 2**32 - 1)
        if flags is None:
            columns["flags"] = np.zeros(len(columns["time_ns"]), np.uint32)
        else:
            columns["flags"] = _column("flags", flags, 0, 2**32 - 1)
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of '{channel}' differ in length: {lengths}")
        count = len(columns["time_ns"])
        if count == 0:
            return
        self._check_open()
        channel_id = self._channel_id(codec.READING, channel)
        rows = encode_rows(channel_id, self._container.count(channel_id), columns)
        try:
            self._container.add_rows(channel_id, rows)
        except OSError as error:
            raise self._failed(error) from error
        self._time_ns = max(self._time_ns, int(columns["time_ns"].max()))
        self._received[channel] += count

    def account(
        self,
        source: str,
        *,
        expected: int,
        dropped_by_device: int = 0,
        dropped_by_host: int = 0,
        lost_in_gaps: int = 0,
        gaps: int = 0,
    ) -> None:
        """Say what became of the readings of ``source`` (a channel); totals since the start.

        What was received the writer counts itself. A channel never accounted for is taken
        to have lost nothing.

        Raises:
            RecordingError: ``source`` is not a channel of the rig.
        """
        self._check_channel(source)
        self._accounts[source] = _Account(
            expected, dropped_by_device, dropped_by_host, lost_in_gaps, gaps
        )

    def ledger(self, time_ns: int | None = None) -> tuple[LedgerEntry, ...]:
        """The ledger as it stands, an entry a channel; as of ``time_ns`` or the last event."""
        return tuple(
            self._entry(source, self._time_ns if time_ns is None else time_ns)
            for source in self._channel_names
        )

    def flush(self, time_ns: int | None = None) -> None:
        """Write the ledger, close the chunk, and hand everything to the operating system.

        After it, a crash of this process costs nothing of what was written before.

        Args:
            time_ns: host time now, for the ledger; the time of the last event where None.

        Raises:
            RecordingError: the recording is closed, or the disk failed.
        """
        self._check_open()
        for entry in self.ledger(time_ns):
            if entry.source not in self._kept_by_caller:
                self._append(codec.kind_of(entry), entry.source, entry)
        try:
            self._container.end_chunk()
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Write the ledger and the summary, and close the file. Does nothing when closed.

        Raises:
            RecordingError: the disk failed; what was flushed before stays readable.
        """
        if self._closed:
            return
        self.flush()
        try:
            self._container.finish()
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error
        self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _append(self, kind: codec.Kind, subject: str, event: Event) -> None:
        self._check_open()
        channel_id = self._channel_id(kind, subject)
        try:
            self._container.add(channel_id, event.time_ns, _payload(event))
        except (struct.error, ValueError) as error:
            raise RecordingError(f"cannot record {event}: {error}") from error
        except OSError as error:
            raise self._failed(error) from error
        self._time_ns = max(self._time_ns, event.time_ns)

    def _channel_id(self, kind: codec.Kind, subject: str) -> int:
        """MCAP channel of a kind's events about ``subject``, registered at its first use."""
        channel_id = self._channel_ids.get((kind, subject))
        if channel_id is None:
            if kind is codec.READING:
                self._check_channel(subject)
            if kind not in self._schema_ids:
                data = codec.schema_data(kind)
                self._schema_ids[kind] = self._container.register_schema(kind.schema_name, data)
            channel_id = self._container.register_channel(
                kind.topic(subject), self._schema_ids[kind]
            )
            self._channel_ids[kind, subject] = channel_id
        return channel_id

    def _entry(self, source: str, time_ns: int) -> LedgerEntry:
        received = self._received[source]
        account = self._accounts.get(source, _Account(received, 0, 0, 0, 0))
        return LedgerEntry(
            source=source,
            time_ns=time_ns,
            expected=account.expected,
            received=received,
            dropped_by_device=account.dropped_by_device,
            dropped_by_host=account.dropped_by_host,
            lost_in_gaps=account.lost_in_gaps,
            gaps=account.gaps,
        )

    def _check_channel(self, name: str) -> None:
        if name not in self._received:
            raise RecordingError(
                f"'{name}' is not a channel of the rig; channels: {_list(self._channel_names)}"
            )

    def _check_open(self) -> None:
        if self._closed:
            raise RecordingError(f"the recording '{self._path}' is closed")

    def _failed(self, error: OSError) -> RecordingError:
        # Nothing behind a failed write could be read, so the file ends here. Closing it tries
        # to write once more, and fails as the first time, which is what gets reported.
        self._closed = True
        with contextlib.suppress(OSError):
            self._file.close()
        return RecordingError(
            f"cannot write to the recording '{self._path}': {error}; "
            "what was written before stays readable"
        )


def _payload(event: Event) -> bytes:
    if isinstance(event, Reading):
        return encode_reading(event.raw, event.device_time_ns, event.sequence, event.flags)
    return codec.encode(event)


def _column(name: str, values: ArrayLike, low: int, high: int) -> NDArray[Any]:
    column = np.asarray(values)
    if column.ndim != 1 or (column.size and column.dtype.kind not in "iu"):
        raise ValueError(
            f"'{name}' has shape {column.shape} of {column.dtype}, expected a row of integers"
        )
    if column.size and (int(column.min()) < low or int(column.max()) > high):
        raise RecordingError(f"'{name}' has values outside {low} ... {high}")
    return column


def _list(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "(there are none)"


__all__ = ["PROFILE", "RIG_ATTACHMENT", "Session", "Writer"]
