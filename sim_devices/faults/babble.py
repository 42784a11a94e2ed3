"""A babbling idiot: a participant that fills its bus or line with what nobody asked for."""

from __future__ import annotations

import random
from collections.abc import Sequence

from sim_devices.can_bus import Frame

IDENTIFIERS = (0x6C0, 0x6FF)
"""Of the frames of a babbler: in no range that CANopen's predefined connection set uses."""

LATEST_S = 0.1
"""A bench that was held up for longer does not make up for it."""


class Babbler:
    """Says random things at a rate; hears nothing.

    Attributes:
        rate_hz: frames or bytes a second, 0 for silence.
    """

    def __init__(self, seed: int) -> None:
        self.rate_hz = 0.0
        self._random = random.Random(seed)
        self._said_s: float | None = None

    def due(self, time_s: float) -> int:
        """How much to say now."""
        if not self.rate_hz:
            self._said_s = None
            return 0
        since_s = time_s if self._said_s is None else max(self._said_s, time_s - LATEST_S)
        count = int((time_s - since_s) * self.rate_hz)
        self._said_s = since_s + count / self.rate_hz
        return count

    def noise(self, length: int) -> bytes:
        """Random bytes."""
        return self._random.randbytes(length)

    def identifier(self) -> int:
        """A random identifier."""
        return self._random.randint(*IDENTIFIERS)


class BabblingNode:
    """A babbler on a CAN bus; see `sim_devices.can_bus.CanNode`."""

    def __init__(self, babbler: Babbler) -> None:
        self._babbler = babbler

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """Hear nothing."""
        return ()

    def tick(self, time_s: float) -> Sequence[Frame]:
        """What it has to say by now."""
        babbler = self._babbler
        return [Frame(babbler.identifier(), babbler.noise(8)) for _ in range(babbler.due(time_s))]


class BabblingDevice:
    """A babbler on a serial line; see `sim_devices.line.SerialDevice`."""

    def __init__(self, babbler: Babbler) -> None:
        self._babbler = babbler

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Hear nothing, and go on."""
        return self.tick(time_s)

    def tick(self, time_s: float) -> bytes:
        """What it has to say by now."""
        return self._babbler.noise(self._babbler.due(time_s))

    def hang_up(self) -> None:
        """It does not care."""
