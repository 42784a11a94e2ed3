"""The adapter's end of slcan, the ASCII protocol of Lawicel's CAN232 and CANUSB.

Bytes of the host -> replies and frames for the bus; frames of the bus -> bytes for the host.
Knows no port and no clock. A command ends with CR; the reply is CR (with a letter or a value
before it) or BELL for anything that cannot be obeyed: an unknown command, a malformed one, or
one that the state of the channel forbids. Malformed input is counted, never fatal.

    command          reply       what it does
    Sn, sxxyy        CR          set the bit rate (closed channel only; the rate is not emulated)
    O, L             CR          open, open to listen only (closed channel only)
    C                CR          close (open channel only)
    tiiildd..        z CR        send a standard data frame; T with 8 id digits: Z CR
    riiil            z CR        send a standard remote frame; R with 8 id digits: Z CR
    V, N             Vhhss, Nxxxx CR   version, serial number
    F                Fxx CR      status flags (open channel only), cleared by reading
    Z0, Z1           CR          frame time stamps off, on (closed channel only)
    Mxxxxxxxx, m..   CR          acceptance code and mask (closed channel only; all is accepted)
    (empty)          CR          hosts send it to flush the line

An adapter that is driven off its bus refuses to send (BELL), hears nothing, and shows it in its
flags (bus error), until the channel is closed and opened again.

Source: Lawicel, "CAN232 manual" and "CANUSB manual", chapter "Available CANUSB ASCII commands".
"""

from __future__ import annotations

import string
from collections.abc import Sequence
from enum import Enum

from sim_devices.can_bus import LARGEST_EXTENDED_ID, LARGEST_LENGTH, LARGEST_STANDARD_ID, Frame

OK = b"\r"
BELL = b"\a"
VERSION = b"V1013"
SERIAL_NUMBER = b"NLC01"
DATA_OVERRUN, BUS_ERROR = 0x08, 0x80

LONGEST_COMMAND = 1 + 8 + 1 + 2 * LARGEST_LENGTH
STAMP_PERIOD_MS = 60_000
HEX_DIGITS = frozenset(string.hexdigits.encode())


class Channel(Enum):
    """Whether the adapter takes part in the bus."""

    CLOSED = "closed"
    LISTENING = "listening"
    OPEN = "open"


class SlcanAdapter:
    """One adapter with one channel.

    Attributes:
        malformed: commands that were not understood, since power on.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self._driven_off = False
        self._is_off = False
        self._channel = Channel.CLOSED
        self._stamps = False
        self._status = 0
        self._buffer = bytearray()
        self._overlong = False

    @property
    def channel(self) -> Channel:
        """Whether the host has opened the channel."""
        return self._channel

    @property
    def bus_off(self) -> bool:
        """Whether something drives the controller off its bus."""
        return self._driven_off

    @bus_off.setter
    def bus_off(self, driven_off: bool) -> None:
        self._driven_off = driven_off
        self._is_off = self._is_off or driven_off

    def hang_up(self) -> None:
        """The host has let go of the port: the channel closes and a half command is forgotten."""
        self._channel = Channel.CLOSED
        self._is_off = self._driven_off
        self._buffer.clear()
        self._overlong = False

    def note_overrun(self) -> None:
        """Frames were lost because the host does not read: shown by the next F command."""
        self._status |= DATA_OVERRUN

    def receive(self, data: bytes) -> Sequence[bytes | Frame]:
        """Take bytes from the host, in pieces of any size.

        Returns:
            In order: bytes to send back, and frames to put on the bus. The reply to a frame
            comes before the frame, so that answers of nodes follow it.
        """
        out: list[bytes | Frame] = []
        self._buffer += data
        while (end := self._buffer.find(b"\r")) >= 0:
            command = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if self._overlong or len(command) > LONGEST_COMMAND:
                self._overlong = False
                self.malformed += 1
                out.append(BELL)
            else:
                out.extend(self._obey(command))
        if len(self._buffer) > LONGEST_COMMAND:
            self._overlong = True
            self._buffer.clear()
        return out

    def encode(self, frame: Frame, time_s: float) -> bytes:
        """What the host is told of a frame on the bus; nothing while the channel is closed.

        Args:
            frame: a frame on the bus.
            time_s: adapter's time, for the stamp in milliseconds modulo one minute.
        """
        if self._channel is Channel.CLOSED or self._is_off:
            return b""
        letter = "t" if frame.remote_length is None else "r"
        length = len(frame.data) if frame.remote_length is None else frame.remote_length
        head = f"{letter}{frame.identifier:03X}{length}"
        if frame.extended:
            head = f"{letter.upper()}{frame.identifier:08X}{length}"
        stamp = f"{int(time_s * 1000) % STAMP_PERIOD_MS:04X}" if self._stamps else ""
        return f"{head}{frame.data.hex().upper()}{stamp}\r".encode()

    def _obey(self, command: bytes) -> Sequence[bytes | Frame]:
        letter, rest = command[:1], command[1:]
        if letter in (b"t", b"T", b"r", b"R"):
            return self._send(letter, rest)
        if command == b"":
            return [OK]
        if command == b"V":
            return [VERSION + OK]
        if command == b"N":
            return [SERIAL_NUMBER + OK]
        if command == b"F":
            return self._report_status()
        if command == b"C":
            return self._move(Channel.CLOSED, allowed=self._channel is not Channel.CLOSED)
        closed = self._channel is Channel.CLOSED
        if command == b"O":
            return self._move(Channel.OPEN, allowed=closed)
        if command == b"L":
            return self._move(Channel.LISTENING, allowed=closed)
        if command in (b"Z0", b"Z1"):
            if closed:
                self._stamps = command == b"Z1"
            return [OK if closed else BELL]
        if _sets_up(letter, rest):
            return [OK if closed else BELL]
        self.malformed += 1
        return [BELL]

    def _move(self, channel: Channel, *, allowed: bool) -> list[bytes | Frame]:
        if not allowed:
            return [BELL]
        self._channel = channel
        self._is_off = self._driven_off
        return [OK]

    def _report_status(self) -> list[bytes | Frame]:
        if self._channel is Channel.CLOSED:
            return [BELL]
        status, self._status = self._status | (BUS_ERROR if self._is_off else 0), 0
        return [b"F%02X\r" % status]

    def _send(self, letter: bytes, rest: bytes) -> list[bytes | Frame]:
        frame = _decode(letter, rest)
        if frame is None:
            self.malformed += 1
            return [BELL]
        if self._channel is not Channel.OPEN or self._is_off:
            return [BELL]
        return [(b"Z" if frame.extended else b"z") + OK, frame]


def _sets_up(letter: bytes, rest: bytes) -> bool:
    """Whether this is a well-formed setup command whose value a virtual bus can ignore."""
    if letter == b"S":
        return len(rest) == 1 and rest.isdigit()
    digits = {b"s": 4, b"M": 8, b"m": 8}.get(letter)
    return len(rest) == digits and HEX_DIGITS.issuperset(rest)


def _decode(letter: bytes, rest: bytes) -> Frame | None:
    """The frame of a t, T, r or R command without its letter, or None where it is malformed."""
    extended = letter.isupper()
    remote = letter in (b"r", b"R")
    digits = 8 if extended else 3
    if len(rest) < digits + 1 or not HEX_DIGITS.issuperset(rest):
        return None
    identifier, length = int(rest[:digits], 16), int(rest[digits : digits + 1], 16)
    payload = rest[digits + 1 :]
    # Three digits could spell 12 bits, eight could spell 32.
    if (
        identifier > (LARGEST_EXTENDED_ID if extended else LARGEST_STANDARD_ID)
        or length > LARGEST_LENGTH
    ):
        return None
    if len(payload) != (0 if remote else 2 * length):
        return None
    data = bytes.fromhex(payload.decode())
    return Frame(identifier, data, extended, length if remote else None)
