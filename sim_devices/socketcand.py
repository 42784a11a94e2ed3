"""The daemon's end of socketcand: a CAN bus over TCP, as text elements between < and >.

    host -> daemon   < open CHANNEL >, < rawmode >, < echo >, < send ID LENGTH DATA.. >
    daemon -> host   < hi > to greet, < ok >, < error .. >, < echo >,
                     < frame ID SECONDS.MICROS DATA > for each frame on the bus, in raw mode

Source: socketcand, doc/protocol.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from sim_devices.can_bus import (
    LARGEST_EXTENDED_ID,
    LARGEST_LENGTH,
    LARGEST_STANDARD_ID,
    CanBus,
    Frame,
)

LONGEST_ELEMENT = 256
GREETING = b"< hi >"


class SocketcandLine:
    """A bus behind a daemon that serves ``channel``. See `sim_devices.line.Line`."""

    def __init__(self, bus: CanBus, channel: str) -> None:
        self._bus = bus
        self._channel = channel
        self._buffer = b""
        self._opened = False
        self._raw = False

    def receive(self, data: bytes, time_s: float) -> bytes:
        """See `Line`."""
        *elements, self._buffer = (self._buffer + data).split(b">")
        self._buffer = self._buffer[-LONGEST_ELEMENT:]
        return b"".join(
            self._obey(element.rpartition(b"<")[2].decode("ascii", "replace").split(), time_s)
            for element in elements
        )

    def tick(self, time_s: float) -> bytes:
        """See `Line`."""
        return self._encode(self._bus.tick(time_s), time_s)

    def hang_up(self) -> None:
        """See `Line`: the next host begins anew."""
        self._buffer = b""
        self._opened = self._raw = False

    def overrun(self) -> None:
        """See `Line`: there is no way to tell."""

    def _obey(self, words: Sequence[str], time_s: float) -> bytes:
        match list(words):
            case ["echo"]:
                return b"< echo >"
            case ["open", channel]:
                self._opened = channel == self._channel
                return b"< ok >" if self._opened else b"< error could not open bus >"
            case ["rawmode"] if self._opened:
                self._raw = True
                return b"< ok >"
            case ["send", identifier, length, *data] if self._raw:
                frame = _frame(identifier, length, data)
                if frame is not None:
                    return self._encode(self._bus.receive(frame, time_s), time_s)
        return b"< error unknown command >"

    def _encode(self, frames: Sequence[Frame], time_s: float) -> bytes:
        if not self._raw:
            return b""
        return b"".join(
            (
                f"< frame {frame.identifier:0{8 if frame.extended else 3}X} {time_s:.6f} "
                f"{frame.data.hex().upper()} >"
            ).encode()
            for frame in frames
            if frame.remote_length is None
        )


def _frame(identifier: str, length: str, data: Sequence[str]) -> Frame | None:
    try:
        number, size = int(identifier, 16), int(length)
        content = bytes(int(each, 16) for each in data)
    except ValueError:
        return None
    extended = len(identifier) > 3
    largest = LARGEST_EXTENDED_ID if extended else LARGEST_STANDARD_ID
    if number > largest or size != len(content) or size > LARGEST_LENGTH:
        return None
    return Frame(number, content, extended)
