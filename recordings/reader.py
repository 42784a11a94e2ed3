"""Reads a recording.

Owns what counts as a recording, and how a reader is told that a file is none, or is
damaged. Reads any MCAP file that keeps to docs/formats.md, whoever wrote it: any chunk
size, compression or field order, with or without a summary.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from recordings.assembly import Assembly
from recordings.errors import DamagedRecording, HopelessRecording, NotARecording
from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    LedgerEntry,
    Mark,
    ModeCommand,
    ModeReport,
    RoundTrip,
    StateChange,
)
from recordings.items import Attachment, Block, Damage, Header, Item, Metadata
from recordings.joining import joined
from recordings.part import FIRST_PART, one_byte_off
from recordings.part_file import PROFILE, RIG_ATTACHMENT
from recordings.recording import Readings, Recording
from recordings.rig import parse_rig
from recordings.session import METADATA_NAME, Session, from_metadata
from recordings.source import opened

_E = TypeVar("_E", bound=Event)
_SHOWN_LINES = 5


def read_recording(path: str | Path, *, damaged_ok: bool = False) -> Recording:
    """Read a whole recording.

    Args:
        path: the file; the first part of a recording in several files stands for all of them,
            and any other part for itself.
        damaged_ok: whether to return what is left of a damaged file, with `Recording.damage`
            saying what is wrong, in place of raising. Damaged chunks are skipped one by one.

    Raises:
        NotARecording: no such file, not MCAP, or an MCAP file of another kind.
        DamagedRecording: it ends early or holds damaged parts; the message says which, and
            what can still be read. With ``damaged_ok`` only where its rig description is lost.
        RigError: the rig description that it carries is not valid.
        RecordingError: the disk failed, or the file may not be read.
    """
    recording = joined(_read_file(Path(path)), _read_file)
    if recording.damage and not damaged_ok:
        raise DamagedRecording(
            f"'{path}' is damaged: {_first_lines(recording.damage)}. "
            f"What can still be read: {_summary(recording)}; "
            f"`loopcal recover {path} -o NEW.mcap` saves it."
        )
    return recording


def _read_file(path: Path) -> Recording:
    """What is left of one file."""
    contents = _Contents(path)
    with opened(path) as source:
        for item in source.items():
            contents.add(item)
    return contents.recording()


class _Contents:
    """What a scan has found so far."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._assembly = Assembly()
        self._damage: list[Damage] = []
        self._rig_toml: bytes | None = None
        self._session: Session | None = None
        self._part = FIRST_PART

    def add(self, item: Item) -> None:
        match item:
            case Block():
                try:
                    self._assembly.add(item)
                except NotARecording as error:
                    raise NotARecording(f"'{self._path}': {error}") from error
            case Header(profile, library):
                if profile != PROFILE and one_byte_off(profile, PROFILE):
                    self._damage.append(Damage(0, f"a header of profile '{profile}'"))
                elif profile != PROFILE:
                    raise NotARecording(
                        f"'{self._path}' is an MCAP file of profile '{profile}' (written by "
                        f"'{library}'), expected profile '{PROFILE}'"
                    )
            case Attachment(name, data):
                if name == RIG_ATTACHMENT and self._rig_toml is None:
                    self._rig_toml = data
            case Metadata(name, pairs):
                try:
                    self._describe(name, pairs)
                except ValueError as error:
                    self._damage.append(Damage(0, f"metadata '{name}': {error}"))
            case Damage():
                self._damage.append(item)

    def _describe(self, name: str, pairs: Mapping[str, str]) -> None:
        self._part = self._part.with_metadata(name, pairs)
        if name != METADATA_NAME:
            return
        session = from_metadata(pairs)
        if self._session is None:
            self._session = session
        elif self._session != session:
            raise ValueError("it stands there twice, and not alike; the first was taken")

    def recording(self) -> Recording:
        self._assembly.finish()
        found = sorted([*self._damage, *self._assembly.damage], key=lambda damage: damage.offset)
        damage = tuple(str(line) for line in found)
        if self._rig_toml is None:
            if damage:
                raise HopelessRecording(
                    f"'{self._path}' is damaged, and its rig description is lost, so that "
                    f"nothing of it can be used: {_first_lines(damage)}"
                )
            raise NotARecording(
                f"'{self._path}' carries no rig description; expected an attachment "
                f"'{RIG_ATTACHMENT}'"
            )
        try:
            rig_toml = self._rig_toml.decode("utf-8")
        except UnicodeDecodeError as error:
            raise NotARecording(
                f"the rig description that '{self._path}' carries is not UTF-8 text: {error}"
            ) from error
        rig = parse_rig(rig_toml, f"the rig description that '{self._path}' carries")
        names = [channel.name for channel in rig.channels]
        for name in self._assembly.channels:
            if name not in names:
                raise NotARecording(
                    f"'{self._path}' holds readings of '{name}', which its rig description does "
                    f"not name; channels: {', '.join(names)}"
                )
        return Recording(
            path=self._path,
            rig=rig,
            rig_toml=rig_toml,
            session=self._session or Session(software=""),
            readings={name: self._assembly.readings(name) for name in names},
            dwells=self._events(Dwell),
            marks=self._events(Mark),
            faults=self._events(Fault),
            mode_commands=self._events(ModeCommand),
            mode_reports=self._events(ModeReport),
            clock=self._events(ClockSample),
            ledger={entry.source: entry for entry in self._events(LedgerEntry)},
            damage=damage,
            states=self._events(StateChange),
            round_trips=self._events(RoundTrip),
            part=self._part,
        )

    def _events(self, kind: type[_E]) -> tuple[_E, ...]:
        found = [event for event in self._assembly.events if isinstance(event, kind)]
        return tuple(sorted(found, key=lambda event: event.time_ns))


def _first_lines(damage: tuple[str, ...]) -> str:
    more = len(damage) - _SHOWN_LINES
    return "; ".join(damage[:_SHOWN_LINES]) + (f"; and {more} more" if more > 0 else "")


def _summary(recording: Recording) -> str:
    read = [readings for readings in recording.readings.values() if len(readings)]
    if not read:
        return "no readings"
    first = min(int(readings.time_ns[0]) for readings in read)
    last = max(int(readings.time_ns[-1]) for readings in read)
    return (
        f"{sum(len(readings) for readings in read)} readings of {len(read)} channels over "
        f"{(last - first) * 1e-9:.3f} s, {len(recording.dwells)} dwells"
    )


__all__ = ["Readings", "Recording", "read_recording"]
