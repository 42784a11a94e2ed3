"""Virtual devices whose messages a DBC file describes, on a CAN bus.

Frames are packed by ``cantools``, not by the code that the drivers read them with. Signals
that nothing is known about are 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cantools
from cantools.database.can import Database, Message

from sim_devices.can_bus import CanNode, Frame
from sim_devices.crystal import Crystal
from sim_devices.errors import DeviceNotSimulated
from sim_devices.plant_seam import Plant, PlantMode

DEFAULT_CYCLE_S = 0.01
CYCLES_OF_PATIENCE = 5
SHORTEST_PATIENCE_S = 1.0
LATEST_S = 0.1
"""A device that was held up for longer does not make up for it."""


def messages_of(text: str, device: str) -> Mapping[str, Message]:
    """The messages of a DBC by name; raises DeviceNotSimulated."""
    try:
        database = cantools.database.load_string(text, "dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise DeviceNotSimulated(f"the file of '{device}' is not a DBC file: {error}") from error
    found = database.messages if isinstance(database, Database) else []
    return {message.name: message for message in found}


def cycle_s(message: Message, cycle_ms: int | None) -> float:
    """Time between two of a message [s]."""
    stated = message.cycle_time if cycle_ms is None else cycle_ms
    return stated * 1e-3 if stated else DEFAULT_CYCLE_S


def packed(message: Message, values: Mapping[str, int]) -> Frame:
    """A frame with raw values; those that are not given, and are in it, are 0."""
    by_name = {signal.name: signal for signal in message.signals}
    full = {
        name: _wrapped(values.get(name, 0), signal.length, signal.is_signed)
        for name, signal in by_name.items()
    }
    data = message.encode(full, scaling=False, strict=False)
    return Frame(message.frame_id, data, message.is_extended_frame)


def unpacked(message: Message, data: bytes) -> Mapping[str, int]:
    """The raw values in a frame; nothing where it is too short."""
    try:
        decoded = message.decode(data, decode_choices=False, scaling=False)
    except (cantools.Error, ValueError):
        return {}
    # Only messages that contain others decode to something else.
    known = decoded if isinstance(decoded, dict) else {}
    return {name: value for name, value in known.items() if isinstance(value, int)}


def _wrapped(value: int, length: int, signed: bool) -> int:
    value %= 1 << length
    return value - (1 << length) if signed and value >> (length - 1) else value


class Cycle:
    """When to send what is sent again and again."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = 0.0

    def due(self, time_s: float) -> int:
        """How many are due by ``time_s``."""
        self._next_s = max(self._next_s, time_s - LATEST_S)
        count = 0
        while self._next_s <= time_s:
            self._next_s += self._period_s
            count += 1
        return count


@dataclass(frozen=True, slots=True)
class SensorMessage:
    """A message that a sensor sends.

    Attributes:
        message: of the DBC.
        signals: channel of the rig that each signal senses.
        counter: signal that counts the messages, "" where there is none.
        clock: signal of the device's time, "" where there is none.
        tick_s: its unit [s].
        period_s: time between two.
    """

    message: Message
    signals: Mapping[str, str]
    counter: str
    clock: str
    tick_s: float
    period_s: float


class DbcSensor(CanNode):
    """An encoder or another sensor: sends its messages by its own crystal, page by page."""

    def __init__(self, messages: Sequence[SensorMessage], plant: Plant, crystal: Crystal) -> None:
        self._plant = plant
        self._crystal = crystal
        self._sending = [(each, Cycle(each.period_s), _pages(each)) for each in messages]
        self._sent = [0] * len(messages)

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """It heeds nobody."""
        return ()

    def tick(self, time_s: float) -> Sequence[Frame]:
        """What is due by now."""
        own_s = self._crystal.elapsed(time_s)
        frames = []
        for k, (each, cycle, pages) in enumerate(self._sending):
            for _ in range(cycle.due(own_s)):
                page = pages[self._sent[k] % len(pages)]
                values = {
                    name: self._plant.sense(channel) for name, channel in each.signals.items()
                }
                values |= {each.counter: self._sent[k], each.clock: int(own_s / each.tick_s)}
                frames.append(packed(each.message, {**values, **page}))
                self._sent[k] += 1
        return frames


def _pages(each: SensorMessage) -> list[dict[str, int]]:
    """Values of the multiplexers with which each of the sensed signals is present."""
    by_name = {signal.name: signal for signal in each.message.signals}
    pages: list[dict[str, int]] = []
    for name in each.signals:
        page, inner = {}, by_name[name]
        while inner.multiplexer_signal is not None:
            page[inner.multiplexer_signal] = next(iter(inner.multiplexer_ids or [0]))
            inner = by_name[inner.multiplexer_signal]
        if page not in pages:
            pages.append(page)
    return pages


@dataclass(frozen=True, slots=True)
class DriveDescription:
    """How a DBC describes a drive; see the driver ``dbc-joint`` for what options mean.

    Attributes:
        command, status: messages.
        mode, target_position, target_torque: signals of the command; "" where there is none.
        reported_mode, error, actual_position: signals of the status, likewise.
        modes, reported_modes: raw value of each mode.
        per_count, at_zero: of a target position.
        command_s, status_s: time between two of each [s].
    """

    command: Message
    status: Message
    mode: str
    reported_mode: str
    modes: Mapping[str, int]
    reported_modes: Mapping[str, int]
    target_position: str
    target_torque: str
    actual_position: str
    error: str
    per_count: float
    at_zero: float
    command_s: float
    status_s: float

    def counts(self, position: int) -> int:
        """Counts of a raw position."""
        return round((position - self.at_zero) / self.per_count)

    def position(self, counts: int) -> int:
        """Raw position of counts."""
        return round(counts * self.per_count + self.at_zero)


class DbcDrive(CanNode):
    """A joint drive that watches its command: after 1 s (or five cycles) without, it is in fault.

    Off acknowledges a fault, once the plant has none.
    """

    def __init__(
        self, description: DriveDescription, joint: str, channel: str, plant: Plant
    ) -> None:
        self._description = description
        self._joint = joint
        self._channel = channel
        self._plant = plant
        self._cycle = Cycle(description.status_s)
        self._patience_s = max(CYCLES_OF_PATIENCE * description.command_s, SHORTEST_PATIENCE_S)
        self._names = {value: name for name, value in description.modes.items()}
        self._mode: PlantMode = "off"
        self._fault = 0
        self._told: tuple[PlantMode, int] = ("off", 0)
        self._heard_s = 0.0

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """Obey a command."""
        d = self._description
        if (frame.identifier, frame.extended) != (d.command.frame_id, d.command.is_extended_frame):
            return ()
        values = unpacked(d.command, frame.data)
        mode = self._names.get(values.get(d.mode, -1))
        if mode is None:
            return ()
        self._heard_s = time_s
        if mode == "off" and not self._plant.drive_fault(self._joint):
            self._fault = 0
        if self._fault:
            mode = "off"
        target = 0
        if mode == "position":
            target = d.counts(values.get(d.target_position, 0))
        elif mode == "torque":
            target = values.get(d.target_torque, 0)
        self._tell(mode, target)
        return ()

    def tick(self, time_s: float) -> Sequence[Frame]:
        """Watch the command and the plant, and say the status when it is due."""
        code = self._plant.drive_fault(self._joint)
        if code and not self._fault:
            self._fail(code)
        if self._mode != "off" and time_s - self._heard_s > self._patience_s:
            self._fail(1)
        return [self._status() for _ in range(min(self._cycle.due(time_s), 1))]

    def _fail(self, code: int) -> None:
        self._fault = code & 0xFF or 1
        self._tell("off", 0)

    def _tell(self, mode: str, target: int) -> None:
        known: dict[str, PlantMode] = {m: m for m in ("off", "free", "position", "torque")}
        self._mode = known[mode]
        if (self._mode, target) != self._told:
            self._told = (self._mode, target)
            self._plant.command(self._joint, self._mode, target)

    def _status(self) -> Frame:
        d = self._description
        shown = d.reported_modes.get("fault" if self._fault else self._mode, 0)
        values = {d.reported_mode: shown, d.error: self._fault}
        values[d.actual_position] = d.position(self._plant.sense(self._channel))
        return packed(d.status, values)
