"""One process data object (CiA 301): its communication and mapping parameters, and its timing.

Objects of a receive PDO (n = 0, 1, ...) at 0x1400 + n and 0x1600 + n, of a transmit PDO at
0x1800 + n and 0x1A00 + n:

    comm sub 1   u32  COB-ID; bit 31 set: PDO does not exist, bit 30: no remote request
    comm sub 2   u8   transmission type: 1..240 every n-th SYNC, 254 and 255 event-driven
    comm sub 3   u16  inhibit time [100 us], transmit only
    comm sub 5   u16  event timer [ms], 0 is off, transmit only
    map  sub 0   u8   number of mapped objects
    map  sub 1.. u32  index << 16 | sub-index << 8 | length in bits

As CiA 301 asks, the COB-ID and the mapping change only while the PDO does not exist (bit
31), and a mapping entry only while their number is 0. Refuses 29-bit COB-IDs, and the
transmission types 0, 252 and 253 of a transmit PDO.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim_devices.canopen.dictionary import U8, U16, U32, AbortCode, ObjectDictionary, Refused

NOT_EXISTING = 1 << 31
EXTENDED_ID = 1 << 29
MOST_OBJECTS = 8
LONGEST_BITS = 64
EVENT_DRIVEN = (254, 255)
INHIBIT_UNIT_S = 1e-4


@dataclass(frozen=True, slots=True)
class Mapped:
    """An object in a PDO."""

    index: int
    sub: int
    bits: int

    @classmethod
    def from_word(cls, word: int) -> Mapped:
        """Read a mapping parameter."""
        return cls(word >> 16, word >> 8 & 0xFF, word & 0xFF)

    @property
    def word(self) -> int:
        """As a mapping parameter."""
        return self.index << 16 | self.sub << 8 | self.bits


@dataclass(frozen=True, slots=True)
class PdoDefaults:
    """How a PDO is set up at power on. ``number`` counts from 1; ``cob_id`` includes bit 31."""

    number: int
    cob_id: int
    transmission: int
    mapping: tuple[Mapped, ...]


class Pdo:
    """A receive or transmit PDO whose objects are in ``dictionary``, its parameters included."""

    def __init__(
        self, defaults: PdoDefaults, dictionary: ObjectDictionary, *, transmit: bool
    ) -> None:
        self.number = defaults.number
        self.cob_id = defaults.cob_id
        self.transmission = defaults.transmission
        self._transmit = transmit
        self._dictionary = dictionary
        self._inhibit_100us = 0
        self._event_ms = 0
        self._mapped = defaults.mapping
        self._count = len(defaults.mapping)
        self._words = [m.word for m in defaults.mapping] + [0] * (MOST_OBJECTS - self._count)
        self._pending = False
        self._syncs = 0
        self._sent_s = 0.0
        self._install()

    @property
    def exists(self) -> bool:
        """Whether the PDO takes part in communication."""
        return not self.cob_id & NOT_EXISTING

    @property
    def identifier(self) -> int:
        """CAN identifier, 11 bits."""
        return self.cob_id & 0x7FF

    @property
    def mapped(self) -> Sequence[Mapped]:
        """The objects in the PDO, in order."""
        return self._mapped

    @property
    def length(self) -> int:
        """Bytes of the mapped objects."""
        return sum(m.bits for m in self._mapped) // 8

    @property
    def on_sync(self) -> bool:
        """Whether SYNC makes it travel (transmit) or take effect (receive)."""
        return self.transmission <= 240

    def start(self, time_s: float) -> None:
        """The node has become operational: what is event-driven is sent once."""
        self._syncs = 0
        self._pending = not self.on_sync
        self._sent_s = time_s - self._inhibit_100us * INHIBIT_UNIT_S

    def event(self, index: int) -> None:
        """The object at ``index`` has changed."""
        if not self.on_sync and any(m.index == index for m in self._mapped):
            self._pending = True

    def sync(self) -> bool:
        """Count a SYNC; whether the PDO is to be sent on it."""
        if not self.exists or not 1 <= self.transmission <= 240:
            return False
        self._syncs += 1
        if self._syncs < self.transmission:
            return False
        self._syncs = 0
        return True

    def due(self, time_s: float) -> bool:
        """Whether an event or the event timer asks to send now, and the inhibit time allows it."""
        if not self.exists or self.on_sync:
            return False
        since_s = time_s - self._sent_s
        timed = self._event_ms > 0 and since_s >= self._event_ms * 1e-3
        return (self._pending or timed) and since_s >= self._inhibit_100us * INHIBIT_UNIT_S

    def content(self, time_s: float) -> bytes:
        """The mapped values now, as they are sent."""
        self._pending = False
        self._sent_s = time_s
        return b"".join(self._dictionary.read(m.index, m.sub) for m in self._mapped)

    def apply(self, data: bytes) -> None:
        """Write a received PDO's values to their objects; raises Refused at the first refusal.

        The last object is written first, because a control word stands in front of the mode
        and targets on which it acts. ``data`` has at least ``length`` bytes; what follows is
        ignored.
        """
        end = self.length
        for m in reversed(self._mapped):
            start = end - m.bits // 8
            self._dictionary.write(m.index, m.sub, data[start:end])
            end = start

    def _install(self) -> None:
        comm = (0x1800 if self._transmit else 0x1400) + self.number - 1
        mapping = comm + 0x200
        add = self._dictionary.add
        add(comm, 0, U8, read=5 if self._transmit else 2)
        add(comm, 1, U32, read=lambda: self.cob_id, write=self._set_cob_id)
        add(comm, 2, U8, read=lambda: self.transmission, write=self._set_transmission)
        if self._transmit:
            add(comm, 3, U16, read=lambda: self._inhibit_100us, write=self._set_inhibit)
            add(comm, 5, U16, read=lambda: self._event_ms, write=self._set_event_timer)
        add(mapping, 0, U8, read=lambda: self._count, write=self._set_count)
        for slot in range(MOST_OBJECTS):
            add(
                mapping,
                slot + 1,
                U32,
                read=lambda slot=slot: self._words[slot],  # type: ignore[misc]
                write=lambda word, slot=slot: self._set_word(slot, word),  # type: ignore[misc]
            )

    def _set_cob_id(self, value: int) -> None:
        if value & EXTENDED_ID:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        moved = (value ^ self.cob_id) & 0x7FF
        if moved and self.exists and not value & NOT_EXISTING:
            raise Refused(AbortCode.NOT_IN_THIS_STATE)
        self.cob_id = value

    def _set_transmission(self, value: int) -> None:
        lowest = 1 if self._transmit else 0
        if not lowest <= value <= 240 and value not in EVENT_DRIVEN:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        self.transmission = value
        self._syncs = 0

    def _set_inhibit(self, value: int) -> None:
        if self.exists:
            raise Refused(AbortCode.NOT_IN_THIS_STATE)
        self._inhibit_100us = value

    def _set_event_timer(self, value: int) -> None:
        self._event_ms = value

    def _set_word(self, slot: int, word: int) -> None:
        if self.exists or self._count:
            raise Refused(AbortCode.NOT_IN_THIS_STATE)
        if word:
            self._check(Mapped.from_word(word))
        self._words[slot] = word

    def _set_count(self, count: int) -> None:
        if self.exists:
            raise Refused(AbortCode.NOT_IN_THIS_STATE)
        if count > MOST_OBJECTS:
            raise Refused(AbortCode.PDO_TOO_LONG)
        mapped = tuple(Mapped.from_word(word) for word in self._words[:count])
        for m in mapped:
            self._check(m)
        if sum(m.bits for m in mapped) > LONGEST_BITS:
            raise Refused(AbortCode.PDO_TOO_LONG)
        self._count, self._mapped = count, mapped

    def _check(self, m: Mapped) -> None:
        entry = self._dictionary.entry(m.index, m.sub)
        access = entry.read if self._transmit else entry.write
        fits = entry.type is not None and m.bits == 8 * entry.type.size
        if not entry.mappable or access is None or not fits:
            raise Refused(AbortCode.NOT_MAPPABLE)
