"""CAN through an slcan adapter (Lawicel's ASCII protocol), read in blocks.

python-can's own slcan bus reads byte by byte: at the frame rates of an arm it takes a third
of a processor, and above 5,000 frames/s it loses frames. This one takes whatever has arrived
at once. It is a python-can bus like any other.

    adapter -> host   t iii l dd..   data frame, 11-bit id;   T iiiiiiii l dd..   29-bit id
                      r iii l        remote frame;            R iiiiiiii l
                      z, Z           a sent frame was taken;  BELL  a command was refused
    host -> adapter   t, T as above; C close, Sn bit rate, O open, L listen only
    each ended by CR, BELL excepted. Four hex digits behind the data are the adapter's time
    stamp [ms], when it was told to send them; they are passed over.

Source: Lawicel, "CAN232 manual" and "CANUSB manual", chapter "Available CANUSB ASCII commands".
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import can
import serial  # type: ignore[import-untyped]
from pydantic import Field

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
WRITE_TIMEOUT_S = 0.25
SHOWN_BYTES = 40


class SlcanOptions(Described):
    """Options of a CAN port with ``interface = "slcan"``.

    Attributes:
        tty_baudrate: baud rate of the serial line to the adapter; a USB adapter ignores it.
        sleep_after_open: time that a board takes to come up, if opening its port resets it [s].
        rtscts: hardware handshake on the serial line.
        listen_only: receive only, without acknowledging frames.
    """

    tty_baudrate: int = Field(default=115_200, gt=0)
    sleep_after_open: float = Field(default=2.0, ge=0, le=60)
    rtscts: bool = False
    listen_only: bool = False


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


def decode(line: bytes) -> can.Message | None:
    """The frame of a line (without its CR), None for a reply to a command; raises Garbled."""
    if line[:1] not in (b"t", b"T", b"r", b"R"):
        if line in (b"", b"z", b"Z") or line[:1] in (b"V", b"N", b"F"):
            return None
        raise Garbled(f"the adapter sent {_shown(line)}, which is no frame")
    extended, remote = line[:1].isupper(), line[:1] in (b"r", b"R")
    start = 9 if extended else 4
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
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=length,
        data=data[:length],
    )


def _shown(line: bytes) -> str:
    return repr(line[:SHOWN_BYTES].decode("ascii", "backslashreplace"))


class LineBuffer:
    """Cuts what arrives into lines. A line longer than any frame is cut off and given as it is."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that ``data`` completes, without their ends. BELL ends a line too."""
        lines = (self._rest + data).replace(BELL, CR).split(CR)
        self._rest = lines.pop()
        if len(self._rest) > LONGEST_LINE:
            lines.append(self._rest)
            self._rest = b""
        return lines


class SlcanBus(can.BusABC):
    """An slcan adapter on a serial port, a pty, or any URL that pyserial knows.

    Args:
        channel: path or URL; ``PATH@BAUD`` sets the baud rate of the line.
        bitrate: bit rate of the bus [bit/s]; one of `BIT_RATES`.
        tty_baudrate, sleep_after_open, rtscts, listen_only: see `SlcanOptions`.

    Raises:
        ValueError: a bit rate that adapters do not know.
        OSError: the port cannot be opened.
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
        **kwargs: Any,
    ) -> None:
        if bitrate not in BIT_RATES:
            known = ", ".join(map(str, BIT_RATES))
            raise ValueError(f"the bit rate is {bitrate}, expected one of: {known}")
        path, _, baudrate = channel.partition("@")
        self._lines = LineBuffer()
        self._received: deque[bytes] = deque()
        self.channel_info = f"slcan {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        self._serial = serial.serial_for_url(
            path,
            baudrate=int(baudrate or tty_baudrate),
            rtscts=rtscts,
            timeout=0.0,
            write_timeout=WRITE_TIMEOUT_S,
        )
        try:
            time.sleep(sleep_after_open)
            for command in (b"C", BIT_RATES[bitrate], b"L" if listen_only else b"O"):
                self._serial.write(command + CR)
        except OSError:
            self._serial.close()
            raise
        super().__init__(channel, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame, waiting at most 0.25 s for the line; raises OSError."""
        self._serial.write(encode(msg))

    def shutdown(self) -> None:
        """Close the CAN channel and the port; a port that is gone is closed all the same."""
        super().shutdown()
        try:
            self._serial.write(b"C" + CR)
        finally:
            self._serial.close()

    def fileno(self) -> int:
        """Descriptor of the port."""
        return int(self._serial.fileno())

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._received.extend(self._lines.feed(self._read(timeout)))
        while self._received:
            message = decode(self._received.popleft())
            if message is not None:
                return message, False
        return None, False

    def _read(self, timeout: float | None) -> bytes:
        """All that is there; if nothing is, what comes first within ``timeout`` seconds."""
        if not self._serial.in_waiting:
            if timeout is not None and timeout <= 0:
                return b""
            if timeout != self._serial.timeout:
                self._serial.timeout = timeout
            first: bytes = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b""
        data: bytes = self._serial.read(self._serial.in_waiting)
        return data
