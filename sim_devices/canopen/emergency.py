"""Emergencies of a node (CiA 301): which errors are present, and what an EMCY object says.

    0x1001 sub 0   u8   error register
    0x1003 sub 0   u8   number of errors in the history; writing 0 clears it
    0x1003 sub 1.. u32  error codes, the newest first

An EMCY object is code (u16), error register (u8) and five bytes of the maker's, here 0. Code
0x0000 says that an error has gone; the register then shows what is left.
"""

from __future__ import annotations

from sim_devices.canopen.dictionary import U8, U32, AbortCode, ObjectDictionary, Refused

HISTORY_LENGTH = 8
NO_ERROR = 0x0000
HEARTBEAT_LOST = 0x8130
NODE_STOPPED = 0x8100
PDO_NOT_PROCESSED = 0x8210
PDO_VALUE_REFUSED = 0x8200

GENERIC = 0x01
REGISTER_BITS = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x8: 0x10, 0xF: 0x80}
"""Error register bit by the first digit of the code: current, voltage, temperature, bus, maker."""


class Emergencies:
    """The errors present in a node and their history."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._present: set[int] = set()
        self._history: list[int] = []
        dictionary.add(0x1001, 0, U8, read=lambda: self.register, mappable=True)
        dictionary.add(0x1003, 0, U8, read=lambda: len(self._history), write=self._clear_history)
        for slot in range(HISTORY_LENGTH):
            dictionary.add(0x1003, slot + 1, U32, read=lambda slot=slot: self._past(slot))  # type: ignore[misc]

    @property
    def register(self) -> int:
        """The error register: generic bit and one bit a kind of error present."""
        bits = (GENERIC | REGISTER_BITS.get(code >> 12, 0) for code in self._present)
        register = 0
        for bit in bits:
            register |= bit
        return register

    def begin(self, code: int) -> bytes | None:
        """Data of the EMCY object that announces an error; None where it is already present."""
        if code in self._present:
            return None
        self._present.add(code)
        return self.note(code)

    def note(self, code: int) -> bytes:
        """Data of the EMCY object of a passing error, one that does not stay present."""
        self._history = [code, *self._history][:HISTORY_LENGTH]
        return self._message(code)

    def end(self, code: int) -> bytes | None:
        """Data of the EMCY object that says an error has gone; None where it was not present."""
        if code not in self._present:
            return None
        self._present.remove(code)
        return self._message(NO_ERROR)

    def _message(self, code: int) -> bytes:
        return code.to_bytes(2, "little") + bytes([self.register, 0, 0, 0, 0, 0])

    def _past(self, slot: int) -> int:
        return self._history[slot] if slot < len(self._history) else 0

    def _clear_history(self, value: int) -> None:
        if value:
            raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
        self._history.clear()
