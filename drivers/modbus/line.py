"""A serial line with one Modbus master: sends a request, waits for the reply that belongs to it.

Owns the port, the silence between frames, and the arrival time of a reply (its last byte).
What bytes are a reply is `drivers.modbus.rtu`'s decision.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from drivers.errors import DeviceRefused, DeviceSilent, Malformed
from drivers.link import Clock
from drivers.modbus.pdu import Identify, Read, Reply, Verdict
from drivers.modbus.rtu import AROUND, bytes_of_others, complete_but_damaged, encode, replies
from drivers.serial_port import Connect, SerialPort, connect
from drivers.waiting import waits
from recordings.rig import SerialPort as RigPort

READ_SLICE_S = 0.01
"""How long one read of the port waits for a byte."""

SHORTEST_SILENCE_S = 1.75e-3
SILENCE_CHARACTERS = 3.5
BITS_PER_CHARACTER = 11


@dataclass(frozen=True, slots=True)
class Answer:
    """A reply that belongs to its request, and when its last byte arrived."""

    reply: Reply
    time_ns: int


class Line(Protocol):
    """What carries requests to devices and their replies back; it can be opened again.

    Attributes:
        late: replies that came after their request had been given up, since the line was made.
        foreign: requests to which a reply of another unit came, since the line was made.
        noise: bytes that were nobody's reply, since the line was made.
        ties_replies: whether a reply proves which request it belongs to.
    """

    late: int
    foreign: int
    noise: int

    @property
    def ties_replies(self) -> bool: ...

    def open(self) -> None:
        """Open the port; raises PortNotFound, PortBusy, PortDenied or LinkBroken."""
        ...

    def close(self) -> None:
        """Let the port go; harmless when it is not open."""
        ...

    def ask(self, request: Read | Identify, timeout_s: float) -> Answer:
        """Send ``request`` and return the reply that belongs to it.

        Raises:
            DeviceSilent: no reply in time.
            DeviceRefused: an exception reply.
            Malformed: a damaged reply.
            LinkBroken: the port is gone.
            LinkClosed: the port is not open.
        """
        ...


class RtuLine(SerialPort):
    """A serial line that can be opened again. See `Line`.

    Args:
        port: what to open.
        clock: stamps arrivals.
        connect: opens it.

    Attributes:
        late: replies that came after their request had been given up, since the line was made.
        foreign: requests to which a reply of another unit came, since the line was made.
        noise: bytes that were nobody's reply, since the line was made.
    """

    ties_replies = False

    def __init__(self, port: RigPort, clock: Clock, connect: Connect = connect) -> None:
        super().__init__(port, connect)
        self._clock = clock
        self._character_s = BITS_PER_CHARACTER / port.baudrate
        self._silence_s = max(SHORTEST_SILENCE_S, SILENCE_CHARACTERS * self._character_s)
        self._busy_until_s = 0.0
        self.late = 0
        self.foreign = 0
        self.noise = 0

    def ask(self, request: Read | Identify, timeout_s: float) -> Answer:
        """Send ``request`` and return the reply that belongs to it; raises as `Line.ask`.

        Args:
            request: what to ask, of whom.
            timeout_s: longest time from the end of the request to the end of the reply, beside
                the time that the bytes take on the line.
        """
        frame = encode(request)
        self._drop_waiting(request)
        self.write(frame)
        # The request may still be in the port's buffer, and the reply takes its time too.
        on_the_line_s = (len(frame) + AROUND + request.longest_reply) * self._character_s
        came = b""
        seen = 0
        for wait_s in waits(on_the_line_s + timeout_s, READ_SLICE_S):
            chunk = self.read(wait_s)
            time_ns = self._clock.now_ns()
            if not chunk:
                if complete_but_damaged(came, request):
                    break
                continue
            self._busy_until_s = time.monotonic() + self._silence_s
            came += chunk
            for reply in list(replies(came, request))[seen:]:
                seen += 1
                if reply.verdict is Verdict.LATE:
                    self.late += 1
                    continue
                self._tell_apart(came, frame, request, answered=True)
                if reply.verdict is Verdict.REFUSAL:
                    raise DeviceRefused(f"unit {request.unit} answers {reply.exception_text}")
                return Answer(reply, time_ns)
        self._tell_apart(came, frame, request, answered=False)
        if complete_but_damaged(came, request):
            raise Malformed(f"unit {request.unit} sent a reply with a wrong checksum: {came.hex()}")
        noise = f", but {len(came)} bytes that are no reply" if came and not seen else ""
        raise DeviceSilent(
            f"unit {request.unit} sent no reply within {timeout_s} s{noise}; check its unit id, "
            f"baud rate ({self._port.baudrate}), parity ({self._port.parity}), power and wiring"
        )

    def _tell_apart(
        self, came: bytes, sent: bytes, request: Read | Identify, *, answered: bool
    ) -> None:
        """Count what came beside the reply: of other units, and of nobody."""
        if len(came) > len(sent) and came.startswith(sent):
            # A two-wire adapter echoes what it sends.
            came = came[len(sent) :]
        if isinstance(request, Identify):
            return
        expected = AROUND + request.longest_reply if answered else 0
        if len(came) > expected:
            others = bytes_of_others(came, request)
            self.foreign += others > 0
            self.noise += max(len(came) - others - expected, 0)

    def _drop_waiting(self, request: Read | Identify) -> None:
        """Drop what came unasked, and let the line be silent before a frame."""
        while data := self.read(0.0):
            late = sum(1 for _ in replies(data, request))
            self.late += late
            self.noise += 0 if late else len(data)
            self._busy_until_s = time.monotonic() + self._silence_s
        left_s = self._busy_until_s - time.monotonic()
        if left_s > 0:
            time.sleep(left_s)
