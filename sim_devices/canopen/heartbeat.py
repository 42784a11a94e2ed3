"""Heartbeats (CiA 301): the beat that a node sends, and its watch over one other node's beat.

    0x1016 sub 1   u32  consumer: node-ID << 16 | time in ms; time or node-ID 0 is off
    0x1017 sub 0   u16  producer time in ms, 0 is off

The watch begins with the first beat of the watched node. Knows no clock: it is told the time.
"""

from __future__ import annotations

from sim_devices.canopen.dictionary import U8, U16, U32, AbortCode, ObjectDictionary, Refused


class HeartbeatProducer:
    """When the next beat is due."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._period_ms = 0
        self._due_s: float | None = None
        dictionary.add(0x1017, 0, U16, read=lambda: self._period_ms, write=self._set_period)

    def due(self, time_s: float) -> bool:
        """Whether to send a beat now; late calls do not make beats pile up."""
        if self._period_ms == 0:
            return False
        period_s = self._period_ms * 1e-3
        if self._due_s is not None and time_s < self._due_s:
            return False
        late = self._due_s is None or time_s >= self._due_s + period_s
        self._due_s = time_s + period_s if late or self._due_s is None else self._due_s + period_s
        return True

    def _set_period(self, value: int) -> None:
        self._period_ms = value
        self._due_s = None


class HeartbeatConsumer:
    """The watch over the node named in 0x1016.

    Attributes:
        expired: whether the beat stopped, has not come back, and the watch was not set up anew.
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self.expired = False
        self._word = 0
        self._heard_s: float | None = None
        dictionary.add(0x1016, 0, U8, read=1)
        dictionary.add(0x1016, 1, U32, read=lambda: self._word, write=self._set_word)

    def hear(self, node_id: int, time_s: float) -> None:
        """A beat of some node has come."""
        if node_id == self._node_id and self._time_ms:
            self._heard_s = time_s
            self.expired = False

    def expires(self, time_s: float) -> bool:
        """Whether the watched beat has just been missing for its whole time."""
        if self._heard_s is None or time_s - self._heard_s <= self._time_ms * 1e-3:
            return False
        self._heard_s = None
        self.expired = True
        return True

    @property
    def _node_id(self) -> int:
        return self._word >> 16 & 0x7F

    @property
    def _time_ms(self) -> int:
        return self._word & 0xFFFF

    def _set_word(self, value: int) -> None:
        if value >> 16 > 0x7F:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        self._word = value
        self._heard_s = None
        self.expired = False
