"""A port that can be unplugged, and bytes that are damaged between an adapter and its host."""

from __future__ import annotations

import random

from sim_devices.errors import SimDevicesError
from sim_devices.faults.slots import flip_a_bit
from sim_devices.line import Line
from sim_devices.port import Port


class Plug:
    """``port``, while it is plugged in; see `sim_devices.port.Port`.

    Without its port, the devices behind it live on: their watchdogs notice that nobody is there.
    """

    def __init__(self, port: Port) -> None:
        self.name = port.name
        self.plugged = True
        self._port = port
        self._present = False

    @property
    def address(self) -> str:
        """Where a host finds it."""
        return self._port.address

    def open(self) -> None:
        """Appear at the address; raises PortTaken or PortUnavailable."""
        self._port.open()
        self._present = True

    def close(self) -> None:
        """Disappear again."""
        self._present = False
        self._port.close()

    def fileno(self) -> int | None:
        """Descriptor that becomes readable when the host sends, or None."""
        return self._port.fileno() if self._present else None

    @property
    def polled(self) -> bool:
        """Whether the port must be served regularly."""
        return self._present and self._port.polled

    def serve(self, time_s: float) -> None:
        """Take what the host has sent and answer it."""
        if self._present:
            self._port.serve(time_s)

    def tick(self, time_s: float) -> None:
        """Let time pass, and put the plug where it belongs."""
        if self._present and not self.plugged:
            self.close()
        elif self.plugged and not self._present:
            self._replug()
        self._port.tick(time_s)

    def _replug(self) -> None:
        try:
            self.open()
        except SimDevicesError:
            # Somebody has taken the path meanwhile; it is tried again at the next tick.
            return


class DamagedLine:
    """``line``, whose bytes on their way to the host are damaged; see `sim_devices.line.Line`.

    Attributes:
        corrupt: probability that a piece of the stream has a bit flipped.
    """

    def __init__(self, line: Line, seed: int) -> None:
        self.corrupt = 0.0
        self._line = line
        self._random = random.Random(seed)

    def receive(self, data: bytes, time_s: float) -> bytes:
        """See `Line`."""
        return self._damaged(self._line.receive(data, time_s))

    def tick(self, time_s: float) -> bytes:
        """See `Line`."""
        return self._damaged(self._line.tick(time_s))

    def hang_up(self) -> None:
        """See `Line`."""
        self._line.hang_up()

    def overrun(self) -> None:
        """See `Line`."""
        self._line.overrun()

    def _damaged(self, data: bytes) -> bytes:
        if not data or self._random.random() >= self.corrupt:
            return data
        return flip_a_bit(data, self._random)
