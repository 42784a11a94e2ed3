"""CAN through an slcan adapter (Lawicel's ASCII protocol), read in blocks.

python-can's own slcan bus reads byte by byte: at the frame rates of an arm it takes a third
of a processor, and above 5,000 frames/s it loses frames. This one takes whatever has arrived
at once. It is a python-can bus like any other, also for other programs: the entry point
``loopcal-slcan`` of the group ``can.interface`` makes it
``can.Bus(interface="loopcal-slcan", channel="/dev/ttyACM0", bitrate=1_000_000)``.

    adapter -> host   t iii l dd..   data frame, 11-bit id;   T iiiiiiii l dd..   29-bit id
                      r iii l        remote frame;            R iiiiiiii l
                      z, Z           a sent frame was taken;  BELL  a command was refused
    host -> adapter   t, T as above; C close, Sn bit rate, O open, L listen only, Z1 stamp frames
    each ended by CR, BELL excepted. Four hex digits behind the data are the adapter's time
    stamp [ms], modulo 60,000, when it was told to send them.

Lines that are neither are counted (`SlcanBus.malformed`) and passed over.

Source: Lawicel, "CAN232 manual" and "CANUSB manual", chapter "Available CANUSB ASCII commands".
"""

from __future__ import annotations

import re
import time
from binascii import unhexlify
from collections import deque
from functools import lru_cache
from itertools import islice
from typing import Any

import can
from can.exceptions import CanInitializationError, CanOperationError
from pydantic import Field

from drivers.serial_blocks import open_blocks
from recordings.rig.quantity import Described

BIT_RATES = {
    10_000: b"S0",
    20_000: b"S1",
    50_000: b"S2",
    100_000: b"S3",
    125_000: b"S4",
    250_000: b"S5",
    500_000: b"S6",
    800_000: b"S7",
    1_000_000: b"S8",
}
CR, BELL = b"\r", b"\a"
LARGEST_STANDARD_ID, LARGEST_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
LONGEST_DATA = 8
LONGEST_LINE = 1 + 8 + 1 + 2 * LONGEST_DATA + 4
STAMP_DIGITS = 4
STAMP_PERIOD_MS = 60_000
SHOWN_BYTES = 40
REFUSED_IN_A_ROW = 6
BUS_OFF = 0x40
"""Class of the error frame that says so, as in the identifier of an error frame of SocketCAN."""

RELAXATION = 2e-4
"""How fast an estimate of the adapter's offset gives way, so that it can follow a drifting clock."""


_PLAIN = 5  # bytes of a data frame with 11-bit identifier and without time stamp, before its data
_PLAIN_HEAD = re.compile(rb"t[0-7][0-9A-Fa-f]{2}[0-8]")
_DIGITS = re.compile(rb"[0-9A-Fa-f]*")


class SlcanOptions(Described):
    """Options of a CAN port with ``interface = "slcan"``.

    Attributes:
        tty_baudrate: baud rate of the serial line to the adapter; a USB adapter ignores it.
        sleep_after_open: time that a board takes to come up, if opening its port resets it [s].
        rtscts: hardware handshake on the serial line.
    """

    tty_baudrate: int = Field(default=115_200, gt=0)
    sleep_after_open: float = Field(default=2.0, ge=0, le=60)
    rtscts: bool = False


class SlcanMessage(can.Message):
    """A received frame.

    Attributes:
        stamp_ms: the adapter's own time stamp, 0 to 59,999, or None where it sent none.
        adapter_ns: the same continued without end since the first [ns], or None.
    """

    __slots__ = ("adapter_ns", "stamp_ms")

    def __init__(self, **fields: Any) -> None:
        super().__init__(**fields)
        self.stamp_ms: int | None = None
        self.adapter_ns: int | None = None


class Garbled(ValueError):
    """A line from the adapter that is no frame and no reply."""


def encode(message: can.Message) -> bytes:
    """The command that sends ``message``."""
    letter = "r" if message.is_remote_frame else "t"
    head = f"{letter}{message.arbitration_id:03X}{message.dlc}"
    if message.is_extended_id:
        head = f"{letter.upper()}{message.arbitration_id:08X}{message.dlc}"
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{head}{data}".encode() + CR


def decode(line: bytes) -> SlcanMessage | None:
    """The frame of a line (without its CR), None for a reply to a command; raises Garbled."""
    if line[:1] not in (b"t", b"T", b"r", b"R"):
        if line in (b"", b"z", b"Z") or line[:1] in (b"V", b"N", b"F"):
            return None
        raise Garbled(f"the adapter sent {_shown(line)}, which is no frame")
    extended, remote = line[:1].isupper(), line[:1] in (b"r", b"R")
    start = 9 if extended else 4
    if not _DIGITS.fullmatch(line, 1):  # which int() and fromhex() do not ask for
        raise Garbled(f"the adapter sent {_shown(line)}, which is no frame")
    try:
        identifier, length = int(line[1:start], 16), int(line[start : start + 1])
        data = b"" if remote else bytes.fromhex(line[start + 1 :].decode("ascii"))
    except ValueError as error:
        raise Garbled(f"the adapter sent {_shown(line)}, which is no frame") from error
    digits = len(line) - start - 1
    expected = 0 if remote else 2 * length
    if length > LONGEST_DATA or digits not in (expected, expected + STAMP_DIGITS):
        raise Garbled(f"the adapter sent {_shown(line)}, whose length is not {length} bytes")
    if identifier > (LARGEST_EXTENDED_ID if extended else LARGEST_STANDARD_ID):
        raise Garbled(f"the adapter sent {_shown(line)}, whose identifier is too large")
    message = SlcanMessage(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=length,
        data=data[:length],
    )
    if digits > expected:
        message.stamp_ms = int(line[-STAMP_DIGITS:], 16)
        if message.stamp_ms >= STAMP_PERIOD_MS:
            raise Garbled(f"the adapter sent {_shown(line)}, whose time stamp is above 59,999 ms")
    return message


def _shown(line: bytes) -> str:
    return repr(line[:SHOWN_BYTES].decode("ascii", "backslashreplace"))


@lru_cache(maxsize=4096)
def _plain_head(head: bytes) -> tuple[int, int]:
    """Identifier and length of the lines that begin so, of plain data frames; -1 for others."""
    if not _PLAIN_HEAD.fullmatch(head):
        return 0, -1
    return int(head[1:4], 16), _PLAIN + 2 * int(head[4:])


class LineBuffer:
    """Cuts what arrives into lines. A line longer than any frame is cut off and given as it is."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that ``data`` completes, without their ends. BELL is a line of its own."""
        lines = (self._rest + data).replace(BELL, CR + BELL + CR).split(CR)
        self._rest = lines.pop()
        if len(self._rest) > LONGEST_LINE:
            lines.append(self._rest)
            self._rest = b""
        return lines


class Refusals:
    """Tells a controller that has left its bus from one that refuses now and then. Pure.

    An adapter has no other way to say it: what it is asked to send is refused, again and again,
    and nothing comes. Setting it up may cost some refusals too, but not so many in a row.
    """

    def __init__(self) -> None:
        self._in_a_row = 0

    def refused(self) -> bool:
        """A command was refused; whether this shows that the controller is off the bus."""
        self._in_a_row += 1
        return self._in_a_row % REFUSED_IN_A_ROW == 0

    def works(self) -> None:
        """A frame was sent or received."""
        self._in_a_row = 0


class AdapterClock:
    """Continues the adapter's time stamps, and says when their frames arrived. Pure.

    What the host sees of a frame's time is late by the transport, never early. So the smallest
    difference between the two clocks is the best estimate of their offset; it gives way by
    `RELAXATION` of the time that passes, to follow drift.
    """

    def __init__(self) -> None:
        self._total_ms: int | None = None
        self._host_s = 0.0
        self._offset_s = 0.0

    def read(self, stamp_ms: int, host_s: float) -> tuple[int, float]:
        """Take a stamp that the host saw at ``host_s``.

        Returns:
            the adapter's time since the first stamp's minute began [ns], and the time of the
            frame on the host's clock [s].
        """
        if self._total_ms is None:
            self._total_ms = stamp_ms
            self._offset_s = host_s - stamp_ms * 1e-3
        else:
            # The stamps wrap every minute; the host's time tells how often they did in a pause.
            since_ms = round((host_s - self._host_s) * 1e3)
            half = STAMP_PERIOD_MS // 2
            surplus = (stamp_ms - self._total_ms - since_ms + half) % STAMP_PERIOD_MS - half
            self._total_ms += since_ms + surplus
            self._offset_s += RELAXATION * (host_s - self._host_s)
        self._host_s = host_s
        self._offset_s = min(self._offset_s, host_s - self._total_ms * 1e-3)
        return self._total_ms * 1_000_000, self._total_ms * 1e-3 + self._offset_s


class SlcanBus(can.BusABC):
    """An slcan adapter on a serial port, a pty, or any URL that pyserial knows.

    Args:
        channel: path or URL; ``PATH@BAUD`` sets the baud rate of the line.
        bitrate: bit rate of the bus [bit/s]; one of `BIT_RATES`.
        tty_baudrate, sleep_after_open, rtscts: see `SlcanOptions`.
        listen_only: receive only, without acknowledging frames.
        time_stamps: tell the adapter to stamp frames. Stamps that come are always used.

    Attributes:
        malformed: lines that made no sense, since the bus was opened.

    ``timestamp`` of a received message is its arrival [s since the Unix epoch]: by the
    adapter's time stamps where there are any, else when the host read it.

    Raises:
        ValueError: a bit rate that adapters do not know.
        CanInitializationError: the port cannot be opened.
    """

    def __init__(
        self,
        channel: str,
        bitrate: int = 1_000_000,
        *,
        tty_baudrate: int = 115_200,
        sleep_after_open: float = 2.0,
        rtscts: bool = False,
        listen_only: bool = False,
        time_stamps: bool = False,
        **kwargs: Any,
    ) -> None:
        if bitrate not in BIT_RATES:
            known = ", ".join(map(str, BIT_RATES))
            raise ValueError(f"the bit rate is {bitrate}, expected one of: {known}")
        path, _, baudrate = channel.partition("@")
        self.malformed = 0
        self._lines = LineBuffer()
        self._received: deque[bytes] = deque()
        self._received_s = 0.0
        self._clock = AdapterClock()
        self._refusals = Refusals()
        self.channel_info = f"slcan {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        try:
            self._port = open_blocks(path, baudrate=int(baudrate or tty_baudrate), rtscts=rtscts)
        except OSError as error:
            raise CanInitializationError(f"cannot open '{path}': {error}") from error
        stamps = (b"Z1",) if time_stamps else ()
        try:
            time.sleep(sleep_after_open)
            for command in (b"C", BIT_RATES[bitrate], *stamps, b"L" if listen_only else b"O"):
                self._port.write(command + CR)
        except OSError as error:
            self._port.close()
            raise CanInitializationError(f"cannot set up '{path}': {error}") from error
        super().__init__(channel, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, waiting at most 0.25 s for the line; raises CanOperationError."""
        try:
            self._port.write(encode(msg))
        except OSError as error:
            raise CanOperationError(f"{self.channel_info} is gone: {error}") from error

    def shutdown(self) -> None:
        """Close the CAN channel and the port; a port that is gone is closed all the same."""
        super().shutdown()
        try:
            self._port.write(b"C" + CR)
        except OSError:
            # An adapter that is gone cannot take the farewell, and nothing depends on it.
            return
        finally:
            self._port.close()

    @property
    def waiting(self) -> bool:
        """Whether lines have been read that nobody has taken yet."""
        return bool(self._received)

    def take_plain(self, timeout: float | None, most: int) -> list[tuple[int, bytes]]:
        """The plain data frames that come next, many at once: a full bus has no time for more.

        Plain are frames with 11-bit identifier and without time stamp; the first line that is
        anything else ends the row, and is for `recv`.

        Args:
            timeout: how long to wait if nothing has come [s]; None for ever.
            most: how many to take at most.

        Returns:
            identifiers and data.

        Raises:
            CanOperationError: the port is gone.
        """
        if not self._received:
            self._fill(timeout)
        frames: list[tuple[int, bytes]] = []
        for line in islice(self._received, most):
            identifier, size = _plain_head(line[:_PLAIN])
            if len(line) != size:
                break
            try:
                frames.append((identifier, unhexlify(line[_PLAIN:])))
            except ValueError:
                break
        for _ in frames:
            self._received.popleft()
        return frames

    def _fill(self, timeout: float | None) -> None:
        try:
            data = self._port.read(timeout)
        except OSError as error:
            raise CanOperationError(f"{self.channel_info} is gone: {error}") from error
        self._received_s = time.time()
        self._received.extend(self._lines.feed(data))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._fill(timeout)
        while self._received:
            line = self._received.popleft()
            if line == BELL:
                if self._refusals.refused():
                    return can.Message(arbitration_id=BUS_OFF, is_error_frame=True), False
                continue
            try:
                message = decode(line)
            except Garbled:
                self.malformed += 1
                continue
            if message is None:
                if line[:1] in (b"z", b"Z"):
                    self._refusals.works()
            else:
                self._refusals.works()
                return self._stamped(message), False
        return None, False

    def _stamped(self, message: SlcanMessage) -> SlcanMessage:
        message.timestamp = self._received_s
        if message.stamp_ms is not None:
            message.adapter_ns, message.timestamp = self._clock.read(
                message.stamp_ms, self._received_s
            )
        return message
