"""The object dictionary of a CANopen node (CiA 301): what each index and sub-index holds.

Owns the types, the access rules and the little-endian encoding of values. Refusals carry
the abort code that an SDO server sends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from sim_devices.errors import SimDevicesError


class AbortCode(IntEnum):
    """SDO abort codes (CiA 301, table "SDO abort codes")."""

    TOGGLE_NOT_ALTERNATED = 0x0503_0000
    COMMAND_SPECIFIER_INVALID = 0x0504_0001
    OUT_OF_MEMORY = 0x0504_0005
    WRITE_ONLY = 0x0601_0001
    READ_ONLY = 0x0601_0002
    NO_SUCH_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_TOO_LONG = 0x0604_0042
    LENGTH_TOO_HIGH = 0x0607_0012
    LENGTH_TOO_LOW = 0x0607_0013
    NO_SUCH_SUBINDEX = 0x0609_0011
    VALUE_OUT_OF_RANGE = 0x0609_0030
    NOT_IN_THIS_STATE = 0x0800_0022


class Refused(SimDevicesError):
    """An access that the dictionary refuses; ``code`` is what the SDO server answers."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"refused with SDO abort code 0x{code:08X} ({code.name})")
        self.code = code


@dataclass(frozen=True, slots=True)
class Integer:
    """An integer type of the dictionary: its size in bytes, and whether it is signed."""

    size: int
    signed: bool = False

    def encode(self, value: int) -> bytes:
        """``value`` modulo the type's width, little-endian."""
        return (value & ((1 << 8 * self.size) - 1)).to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """The value of exactly ``size`` bytes; raises Refused."""
        if len(data) > self.size:
            raise Refused(AbortCode.LENGTH_TOO_HIGH)
        if len(data) < self.size:
            raise Refused(AbortCode.LENGTH_TOO_LOW)
        return int.from_bytes(data, "little", signed=self.signed)


U8, U16, U32 = Integer(1), Integer(2), Integer(4)
I8, I16, I32 = Integer(1, signed=True), Integer(2, signed=True), Integer(4, signed=True)


@dataclass(frozen=True, slots=True)
class Entry:
    """One sub-index: how to read and write it (None where it cannot be), and who may map it."""

    type: Integer | None
    read: Callable[[], bytes] | None
    write: Callable[[bytes], None] | None
    mappable: bool = False


class ObjectDictionary:
    """All objects of a node, by index and sub-index."""

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._indices: set[int] = set()

    def add(
        self,
        index: int,
        sub: int,
        kind: Integer,
        *,
        read: Callable[[], int] | int | None = None,
        write: Callable[[int], None] | None = None,
        mappable: bool = False,
    ) -> None:
        """Put in an integer object: ``read`` and ``write`` are called at each access.

        ``write`` raises Refused for a value that it does not take. A plain number as ``read``
        is a constant.
        """
        get: Callable[[], bytes] | None = None
        put: Callable[[bytes], None] | None = None
        if isinstance(read, int):
            constant = kind.encode(read)
            get = lambda: constant  # noqa: E731 - as short as what it says
        elif read is not None:
            source = read
            get = lambda: kind.encode(source())  # noqa: E731
        if write is not None:
            sink = write
            put = lambda data: sink(kind.decode(data))  # noqa: E731
        self._put(index, sub, Entry(kind, get, put, mappable))

    def add_text(self, index: int, text: str) -> None:
        """Put in a constant VISIBLE_STRING at sub-index 0."""
        data = text.encode("ascii")
        self._put(index, 0, Entry(None, lambda: data, None))

    def add_register(
        self,
        index: int,
        sub: int,
        kind: Integer,
        value: int,
        *,
        low: int | None = None,
        high: int | None = None,
        changed: Callable[[int], None] | None = None,
        mappable: bool = False,
    ) -> None:
        """Put in a value that is kept until it is written, within [low, high]."""
        cell = [value]

        def write(new: int) -> None:
            if (low is not None and new < low) or (high is not None and new > high):
                raise Refused(AbortCode.VALUE_OUT_OF_RANGE)
            cell[0] = new
            if changed is not None:
                changed(new)

        self.add(index, sub, kind, read=lambda: cell[0], write=write, mappable=mappable)

    def entry(self, index: int, sub: int) -> Entry:
        """The entry at an index and sub-index; raises Refused where there is none."""
        entry = self._entries.get((index, sub))
        if entry is None:
            known = index in self._indices
            raise Refused(AbortCode.NO_SUCH_SUBINDEX if known else AbortCode.NO_SUCH_OBJECT)
        return entry

    def read(self, index: int, sub: int) -> bytes:
        """Little-endian value of an object; raises Refused."""
        entry = self.entry(index, sub)
        if entry.read is None:
            raise Refused(AbortCode.WRITE_ONLY)
        return entry.read()

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Give an object a little-endian value; raises Refused, then nothing has changed."""
        entry = self.entry(index, sub)
        if entry.write is None:
            raise Refused(AbortCode.READ_ONLY)
        entry.write(data)

    def _put(self, index: int, sub: int, entry: Entry) -> None:
        self._entries[index, sub] = entry
        self._indices.add(index)
