"""Writes a recording.

Owns the order of what is in the files, from their creation to their summaries, what is said at the
turn from one part to the next, and an orderly end when the disk fails. Reads no clock: every
time in a recording is the time of an event.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from numpy.typing import ArrayLike

from recordings import codec
from recordings.errors import DiskFailed, RecordingError
from recordings.events import Event, Fault, LedgerEntry, ModeCommand, ModeReport, Reading
from recordings.ledger import Ledger, Losses
from recordings.part_file import PROFILE, RIG_ATTACHMENT, PartFile
from recordings.rig import SerialMechanism, parse_rig
from recordings.rows import checked_columns
from recordings.series import Series
from recordings.session import Session
from recordings.storage import Storage, disk_error
from recordings.topics import Topics
from recordings.wire import encode_reading, encode_rows


class Writer:
    """A recording being written. A context manager; one thread at a time.

    Args:
        path: file to create; the first one, where it is written in parts.
        rig_toml: the rig description, attached exactly as it is.
        session: who records, when and with what.
        storage: how it is kept on disk.

    Raises:
        RigError: ``rig_toml`` is not a valid rig; nothing is created.
        RecordingError: the file, or a part of this name, exists already; or it cannot be
            created.
    """

    def __init__(
        self,
        path: str | Path,
        rig_toml: str,
        session: Session,
        storage: Storage | None = None,
    ) -> None:
        rig = parse_rig(rig_toml)
        self._channel_names = tuple(channel.name for channel in rig.channels)
        joints = rig.mechanism.places if isinstance(rig.mechanism, SerialMechanism) else ()
        self._joint_names = tuple(joints)
        self._time_ns = session.start_ns
        self._ledger = Ledger()
        self._closed = False
        self._series = Series(Path(path), rig_toml, session, storage or Storage())
        self._topics = Topics(self._file.container)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files written so far, in order."""
        return self._series.paths

    @property
    def nearly_full(self) -> str:
        """What to tell the operator where the disk has less room than the reserve, or "".

        The reserve is there to end the session with: drives made safe, ledger and summary
        written.
        """
        return self._series.nearly_full

    def write(self, event: Event) -> None:
        """Record one event.

        A `LedgerEntry` is recorded as it stands, and from then on its source's ledger is
        the caller's to keep.

        Raises:
            RecordingError: its channel or joint is not in the rig, a number does not fit, or
                the recording is closed.
            DiskFailed: the disk is full or failed, and the recording ends here.
        """
        if isinstance(event, Reading):  # nearly all events are: no detours for them
            self._append(codec.READING, event.channel, event)
            self._turn_if_due()
            return
        kind = codec.kind_of(event)
        subject = "" if kind.subject is None else str(getattr(event, kind.subject))
        if isinstance(event, ModeCommand | ModeReport) and event.joint not in self._joint_names:
            raise RecordingError(
                f"'{event.joint}' is not a joint of the rig; joints: {_list(self._joint_names)}"
            )
        if isinstance(event, LedgerEntry):
            self._ledger.take(event)
        self._append(kind, subject, event)
        self._turn_if_due()

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
            RecordingError: unknown channel, a value that does not fit, or closed.
            DiskFailed: the disk is full or failed, and the recording ends here.
            ValueError: the arrays are not one-dimensional integers of one length.
        """
        given = {"time_ns": time_ns, "raw": raw, "device_time_ns": device_time_ns}
        columns = checked_columns(channel, given | {"sequence": sequence, "flags": flags})
        count = len(columns["time_ns"])
        if count == 0:
            return
        self._check_open()
        channel_id = self._channel_id(codec.READING, channel)
        before = self._file.container.sequence(channel_id)
        rows = encode_rows(channel_id, before, columns)
        try:
            self._file.container.add_rows(channel_id, rows)
        except OSError as error:
            left = before + count - self._file.container.sequence(channel_id)
            raise self._failed(error, {channel_id: left}) from error
        self._time_ns = max(self._time_ns, int(columns["time_ns"].max()))
        self._turn_if_due()

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
        losses = Losses(expected, dropped_by_device, dropped_by_host, lost_in_gaps, gaps)
        self._ledger.account(source, losses)

    def ledger(self, time_ns: int | None = None) -> tuple[LedgerEntry, ...]:
        """The ledger as it stands, an entry a channel; as of ``time_ns`` or the last event."""
        at = self._time_ns if time_ns is None else time_ns
        return tuple(
            self._ledger.entry(name, self._topics.received(name), at)
            for name in self._channel_names
        )

    def flush(self, time_ns: int | None = None) -> None:
        """Write the ledger, close the chunk, and hand everything to the operating system.

        After it, a crash of this process costs nothing of what was written before; with
        `Sync.FLUSH`, power loss does not either.

        Args:
            time_ns: host time now, for the ledger; the time of the last event where None.

        Raises:
            RecordingError: the recording is closed.
            DiskFailed: the disk is full or failed, and the recording ends here.
        """
        self._check_open()
        self._write_ledger(time_ns)
        try:
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error
        self._turn_if_due()

    def close(self) -> None:
        """Write the ledger and the summary, and close the file. Does nothing when closed.

        Raises:
            DiskFailed: the disk is full or failed; what was flushed before stays readable.
        """
        if self._closed:
            return
        self._write_ledger(None)
        try:
            self._file.finish()
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
            self._file.container.add(channel_id, event.time_ns, _payload(event))
        except (struct.error, ValueError) as error:
            raise RecordingError(f"cannot record {event}: {error}") from error
        except OSError as error:
            raise self._failed(error) from error
        self._time_ns = max(self._time_ns, event.time_ns)

    def _channel_id(self, kind: codec.Kind, subject: str) -> int:
        """MCAP channel of a kind's events about ``subject``, registered at its first use."""
        found = self._topics.find(kind, subject)
        if found is not None:
            return found
        if kind is codec.READING:
            self._check_channel(subject)
        return self._topics.register(kind, subject)

    def _write_ledger(self, time_ns: int | None, *, of_caller: bool = False) -> None:
        for entry in self.ledger(time_ns):
            if of_caller or not self._ledger.is_kept_by_caller(entry.source):
                self._append(codec.kind_of(entry), entry.source, entry)

    @property
    def _file(self) -> PartFile:
        return self._series.file

    def _turn_if_due(self) -> None:
        """Go on in the next part where this one is large or long enough."""
        if not self._series.is_due(self._time_ns):
            return
        old = self._file
        received = {name: self._topics.received(name) for name in self._channel_names}
        try:
            new = self._series.next_file(received)
        except RecordingError as error:
            text = f"no further part was begun: {error}"
            fault = Fault(self._time_ns, "recording", "rotation", text)
            self._append(codec.kind_of(fault), "", fault)
            return
        try:
            self._write_ledger(None)
            old.finish(new.path.name)
        except OSError as error:
            new.discard()
            raise self._failed(error) from error
        except DiskFailed:
            new.discard()
            raise
        self._series.file = new
        self._topics = self._topics.carried_to(new.container)
        self._write_ledger(None, of_caller=True)
        try:
            new.flush()
        except OSError as error:
            raise self._failed(error) from error
        self._series.begun(self._time_ns)

    def _check_channel(self, name: str) -> None:
        if name not in self._channel_names:
            raise RecordingError(
                f"'{name}' is not a channel of the rig; channels: {_list(self._channel_names)}"
            )

    def _check_open(self) -> None:
        if self._closed:
            raise RecordingError(f"the recording '{self._file.path}' is closed")

    def _failed(self, error: OSError, not_taken: Mapping[int, int] | None = None) -> DiskFailed:
        """End the recording behind what was written, with a ledger that says what was lost.

        Args:
            error: why a write failed.
            not_taken: messages of each MCAP channel that were handed over and not even tried.
        """
        self._closed = True
        self._file.end_early()
        lost = Counter(self._file.container.abandon_chunk())
        lost.update(not_taken or {})
        names = self._topics.readings()
        readings = {names[key]: count for key, count in lost.items() if count and key in names}
        for channel, count in readings.items():
            self._ledger.lose(channel, count)
        others = lost.total() - sum(readings.values())
        told = f"{sum(readings.values())} readings and {others} other messages are lost"
        text = f"{disk_error(error)}; {told}"
        try:
            fault = Fault(self._time_ns, "recording", "disk", text)
            last: list[Event] = [fault, *self.ledger()]
            for event in last:
                kind = codec.kind_of(event)
                channel_id = self._channel_id(kind, getattr(event, kind.subject or "", ""))
                self._file.container.add(channel_id, event.time_ns, _payload(event))
            self._file.finish()
            ended = "the recording was closed, with all that was written before and its ledger"
        except OSError:
            self._file.leave()
            ended = (
                "the recording could not be closed; `loopcal recover` reads what was written before"
            )
        return DiskFailed(
            f"cannot go on with the recording '{self._file.path}': {text}; {ended}", readings
        )


def _payload(event: Event) -> bytes:
    if isinstance(event, Reading):
        return encode_reading(event.raw, event.device_time_ns, event.sequence, event.flags)
    return codec.encode(event)


def _list(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "(there are none)"


__all__ = ["PROFILE", "RIG_ATTACHMENT", "Session", "Writer"]
