"""What is at the far end of one port: the bytes that virtual devices answer to a host's bytes.

A `Line` knows no port and no clock. Port and line meet in this protocol only, so anything that
is a `Line` itself may stand between them and disturb what passes: this is where faults of the
wire (silence, babble, damaged or late bytes) are put in, while an unplugged cable is a port
that closes and opens.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from sim_devices.can_bus import CanBus, Frame
from sim_devices.slcan import SlcanAdapter


class Line(Protocol):
    """The far end of a port that carries bytes. Times in s since the bench started."""

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes from the host, in pieces of any size; returns what to send back."""

    def tick(self, time_s: float) -> bytes:
        """Let time pass; returns what became due. Called every few milliseconds."""

    def hang_up(self) -> None:
        """The host has let go of the port."""

    def overrun(self) -> None:
        """Bytes for the host were thrown away, because it does not read."""


class SerialDevice(Protocol):
    """One device on a serial line; it hears every byte of the host."""

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes from the line; returns what to answer."""

    def tick(self, time_s: float) -> bytes:
        """Let time pass; returns what to send."""

    def hang_up(self) -> None:
        """The host has let go of the port."""


class SerialLine:
    """A serial line with any number of devices."""

    def __init__(self, devices: Sequence[SerialDevice]) -> None:
        self._devices = tuple(devices)

    def receive(self, data: bytes, time_s: float) -> bytes:
        """See `Line`."""
        return b"".join(device.receive(data, time_s) for device in self._devices)

    def tick(self, time_s: float) -> bytes:
        """See `Line`."""
        return b"".join(device.tick(time_s) for device in self._devices)

    def hang_up(self) -> None:
        """See `Line`."""
        for device in self._devices:
            device.hang_up()

    def overrun(self) -> None:
        """See `Line`: a serial line has no way to tell."""


class SlcanLine:
    """A CAN bus behind an slcan adapter."""

    def __init__(self, bus: CanBus) -> None:
        self.adapter = SlcanAdapter()
        self._bus = bus

    def receive(self, data: bytes, time_s: float) -> bytes:
        """See `Line`."""
        out = []
        for item in self.adapter.receive(data):
            if isinstance(item, Frame):
                out.append(self._encode(self._bus.receive(item, time_s), time_s))
            else:
                out.append(item)
        return b"".join(out)

    def tick(self, time_s: float) -> bytes:
        """See `Line`."""
        return self._encode(self._bus.tick(time_s), time_s)

    def hang_up(self) -> None:
        """See `Line`: the channel closes, the bus goes on."""
        self.adapter.hang_up()

    def overrun(self) -> None:
        """See `Line`."""
        self.adapter.note_overrun()

    def _encode(self, frames: Sequence[Frame], time_s: float) -> bytes:
        return b"".join(self.adapter.encode(frame, time_s) for frame in frames)
