"""The place of one virtual device on its bus or line, and what can happen to it there.

A slot holds the device that answers at a place: one, none while it has no power, two where
its number is given twice. Devices are built anew when their power comes back, and their time
counts from then. What they say passes the slot's disturbances on its way to the host: silence,
loss, damage, delay. A slot is a device like any other to its bus or line.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from recordings.rig import Device
from sim_devices.can_bus import CanNode, Frame
from sim_devices.faults.vocabulary import ADDRESS_KEYS
from sim_devices.line import SerialDevice
from sim_devices.modbus import crc16

BOOT_S = 0.2
"""How long a device is without power when it restarts."""

Unit = TypeVar("Unit", CanNode, SerialDevice)
Message = TypeVar("Message", Frame, bytes)


@dataclass(slots=True)
class Disturbance:
    """What happens to a device's messages.

    Attributes:
        detached: it neither hears nor is heard.
        silent: it says nothing.
        drop: probability that a message is lost.
        corrupt: probability that a message is damaged.
        delay_s: how much later a message arrives.
        foreign: whether another unit's reply comes in front of each of its own.
    """

    detached: bool = False
    silent: bool = False
    drop: float = 0.0
    corrupt: float = 0.0
    delay_s: float = 0.0
    foreign: bool = False


class Slot(Generic[Unit, Message]):
    """The place of ``device``.

    Args:
        device: the device, as the rig describes it.
        make: builds what answers at the place.
        power_off: unpowers the joint that it moves, if it moves one.
        damage: what is left of a message that is corrupted.
        seed: of all that is random here.

    Attributes:
        disturbance: what happens to its messages now.
        dropped: messages that were lost on their way, by the fault of that name.
    """

    def __init__(
        self,
        device: Device,
        make: Callable[[Device], Unit],
        power_off: Callable[[], None],
        damage: Callable[[Message, random.Random], Message],
        seed: int,
    ) -> None:
        self.disturbance = Disturbance()
        self.dropped = 0
        self._own = self._device = device
        self._make: Callable[[Device], Unit] = make
        self._power_off = power_off
        self._damage: Callable[[Message, random.Random], Message] = damage
        self._random = random.Random(f"{seed} {device.name}")
        self._units: list[tuple[Unit, float]] = [(make(device), 0.0)]
        self._doubled = False
        self._boots_s: float | None = None
        self._delayed: list[tuple[float, Message]] = []

    def restart(self, time_s: float) -> None:
        """Take its power away; it comes back after `BOOT_S`."""
        self._units.clear()
        self._delayed.clear()
        self._boots_s = time_s + BOOT_S
        self._power_off()

    def renumber(self, number: int | None, time_s: float) -> None:
        """Let it come back with another number, None for its own; harmless where it has none."""
        key = next((key for key in ADDRESS_KEYS if key in self._own.options), None)
        if key is None:
            return
        options = {**self._own.options, key: self._own.options[key] if number is None else number}
        self._device = self._own.model_copy(update={"options": options})
        self.restart(time_s)

    def double(self, doubled: bool, time_s: float) -> None:
        """Let a second device of the same number appear, or disappear."""
        self._doubled = doubled
        if doubled and self._units:
            self._units.append((self._make(self._device), time_s))
        del self._units[2 if doubled else 1 :]

    def _powered(self, time_s: float) -> Sequence[tuple[Unit, float]]:
        """The devices that have power, with their times; those whose power is back are built."""
        if self._boots_s is not None and time_s >= self._boots_s:
            copies = 2 if self._doubled else 1
            self._units = [(self._make(self._device), self._boots_s) for _ in range(copies)]
            self._boots_s = None
        return [(unit, time_s - since_s) for unit, since_s in self._units]

    def _arriving(self, said: Sequence[Message], time_s: float) -> list[Message]:
        """What reaches the host now, of what is said now and what was said before."""
        disturbance = self.disturbance
        if disturbance.silent or disturbance.detached:
            said = ()
        for message in said:
            if disturbance.drop and self._random.random() < disturbance.drop:
                self.dropped += 1
                continue
            damaged = bool(disturbance.corrupt) and self._random.random() < disturbance.corrupt
            arrives = self._damage(message, self._random) if damaged else message
            # A delay that has become shorter lets nothing overtake what is under way.
            before_s = self._delayed[-1][0] if self._delayed else time_s
            self._delayed.append((max(time_s + disturbance.delay_s, before_s), arrives))
        arriving = [message for due_s, message in self._delayed if due_s <= time_s]
        self._delayed = [(due_s, message) for due_s, message in self._delayed if due_s > time_s]
        return arriving


class CanSlot(Slot[CanNode, Frame]):
    """The place of a node on a CAN bus; see `sim_devices.can_bus.CanNode`."""

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """Hear one frame; returns what arrives at the host at once."""
        heard = () if self.disturbance.detached else self._powered(time_s)
        said = [answer for node, own_s in heard for answer in node.receive(frame, own_s)]
        return self._arriving(said, time_s)

    def tick(self, time_s: float) -> Sequence[Frame]:
        """Let time pass; returns what arrives at the host."""
        said = [frame for node, own_s in self._powered(time_s) for frame in node.tick(own_s)]
        return self._arriving(said, time_s)


class LineSlot(Slot[SerialDevice, bytes]):
    """The place of a device on a line; see `sim_devices.line.SerialDevice`.

    ``tcp`` says that the line is a connection, on which nothing collides.
    """

    def __init__(
        self,
        device: Device,
        make: Callable[[Device], SerialDevice],
        power_off: Callable[[], None],
        seed: int,
        *,
        tcp: bool = False,
    ) -> None:
        super().__init__(device, make, power_off, flip_a_bit, seed)
        self._tcp = tcp

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes from the line; returns what arrives at the host at once."""
        heard = () if self.disturbance.detached else self._powered(time_s)
        return self._say([device.receive(data, own_s) for device, own_s in heard], time_s)

    def tick(self, time_s: float) -> bytes:
        """Let time pass; returns what arrives at the host."""
        return self._say([device.tick(own_s) for device, own_s in self._powered(time_s)], time_s)

    def hang_up(self) -> None:
        """The host has let go of the port."""
        self._delayed.clear()
        for device, _ in self._units:
            device.hang_up()

    def _say(self, answers: Sequence[bytes], time_s: float) -> bytes:
        given = [answer for answer in answers if answer]
        said = b"".join(given) if self._tcp else _collided(given)
        if said and self.disturbance.foreign:
            said = (_of_another_server if self._tcp else _of_another_unit)(said) + said
        return b"".join(self._arriving([said] if said else [], time_s))


def undamaged(frame: Frame, _: random.Random) -> Frame:
    """A CAN frame as it was: a controller delivers no frame with a wrong checksum."""
    return frame


def flip_a_bit(data: bytes, rng: random.Random) -> bytes:
    """``data`` with one of its bits flipped."""
    at = rng.randrange(8 * len(data))
    damaged = bytearray(data)
    damaged[at // 8] ^= 1 << at % 8
    return bytes(damaged)


def _collided(answers: Sequence[bytes]) -> bytes:
    """What two answers at once make of each other: on RS-485, a 0 wins over a 1, bit by bit."""
    if not answers:
        return b""
    length = max(len(answer) for answer in answers)
    bits = (1 << 8 * length) - 1
    for answer in answers:
        bits &= int.from_bytes(answer.ljust(length, b"\xff"), "big")
    return bits.to_bytes(length, "big")


def _of_another_unit(reply: bytes) -> bytes:
    """A Modbus RTU reply as the next unit would have sent it."""
    body = bytes([reply[0] % 247 + 1]) + reply[1:-2]
    return body + crc16(body).to_bytes(2, "little")


def _of_another_server(reply: bytes) -> bytes:
    """A Modbus TCP reply as the next unit would have sent it."""
    return reply[:6] + bytes([reply[6] % 247 + 1]) + reply[7:]
