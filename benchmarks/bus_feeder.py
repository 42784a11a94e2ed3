"""The far end of the wires of `capture_load.py`, in a process of its own. Not run by hand.

Pseudo-terminals behave like slcan adapters on saturated buses and like Modbus converters.
Every frame carries its number and the moment at which it was written (CLOCK_MONOTONIC, us).
Like an adapter, it never waits: frames for which the terminal has no room are lost, and
their numbers are kept. With faults, it also unplugs buses, garbles frames and leaves frames out,
and keeps account of each. Reads its task as JSON from stdin; ends when stdin ends; then writes
its account to stdout.
"""

from __future__ import annotations

import errno
import json
import os
import select
import struct
import sys
import time
import tty
from pathlib import Path
from random import Random
from typing import Any

from pymodbus.framer import FramerRTU

TICK_S = 0.002
READ = 65_536
READ_INPUT, READ_BYTES, IDENTIFY_BYTES = 4, 8, 7
CHANGE_S = 1.5  # mean time between two faults of a bus
LONGEST_AWAY_S = 1.5


def now_us() -> int:
    """CLOCK_MONOTONIC [us]."""
    return time.monotonic_ns() // 1000


class Terminal:
    """A pseudo-terminal that can be found under a link, and unplugged."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.master: int | None = None
        self._slave = -1

    def plug(self) -> None:
        """Make it, and its link."""
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        aside = self._path.with_suffix(".new")
        aside.symlink_to(os.ttyname(self._slave))
        aside.rename(self._path)

    def unplug(self) -> None:
        """Take it away, with what nobody has read yet."""
        if self.master is not None:
            self._path.unlink()
            os.close(self.master)
            os.close(self._slave)
            self.master = None

    def write(self, data: bytes) -> int:
        """How many bytes there was room for."""
        try:
            return os.write(self.master, data) if self.master is not None else 0
        except BlockingIOError:
            return 0

    def read(self) -> bytes:
        """What has come."""
        try:
            return os.read(self.master, READ) if self.master is not None else b""
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:  # nobody has it open
                return b""
            raise


class Bus:
    """An slcan adapter on a bus with some encoders, each frame of theirs numbered."""

    def __init__(self, task: dict[str, Any], path: Path, random: Random | None) -> None:
        self._terminal = Terminal(path)
        self._terminal.plug()
        self._heads = [f"t{identifier:03X}8" for identifier in task["identifiers"]]
        self._rate = task["rate"]
        self._random = random
        self._sent = 0
        self._rest = b""
        self._back_us = 0
        self._next_us = now_us() + 3_000_000
        self.lost: dict[str, list[int]] = {
            "no room": [],
            "unplugged": [],
            "garbled": [],
            "left out": [],
        }
        self.faults = 0

    def serve(self, elapsed_s: float) -> None:
        """Send the frames that have come by now; the n-th is of encoder n modulo their number."""
        self._terminal.read()
        if self._random is not None:
            self._change()
        due = int(elapsed_s * self._rate) - self._sent
        numbers = range(self._sent, self._sent + due)
        self._sent += due
        if self._terminal.master is None:
            self.lost["unplugged"] += numbers
            return
        if self._rest:
            self._rest = self._rest[self._terminal.write(self._rest) :]
        if self._rest:
            self.lost["no room"] += numbers
            return
        kinds = len(self._heads)
        stamp = now_us() % 2**32
        lines, places = [], []
        for n in numbers:
            line = f"{self._heads[n % kinds]}{struct.pack('<II', n // kinds, stamp).hex()}\r"
            spoilt = self._spoilt(n)
            if spoilt == "left out":
                continue
            lines.append(line[:9] + "?" + line[10:] if spoilt else line)
            places.append(None if spoilt else n)
        data = "".join(lines).encode()
        written = self._terminal.write(data)
        if written < len(data):
            size = len(lines[0])
            whole = -(-written // size)  # the frame under way is ended later
            self._rest = data[written : whole * size]
            self.lost["no room"] += [n for n in places[whole:] if n is not None]

    def _spoilt(self, number: int) -> str:
        """Whether this frame is garbled or left out."""
        if self._random is None or self._random.random() > 0.002:
            return ""
        kind = self._random.choice(("garbled", "left out"))
        self.lost[kind].append(number)
        self.faults += 1
        return kind

    def _change(self) -> None:
        """Unplug or plug when it is time."""
        assert self._random is not None
        if self._terminal.master is None:
            if now_us() >= self._back_us:
                self._terminal.plug()
        elif now_us() >= self._next_us:
            self._terminal.unplug()
            self._rest = b""
            self.faults += 1
            away_s = self._random.uniform(0.05, LONGEST_AWAY_S)
            self._back_us = now_us() + int(1e6 * away_s)
            self._next_us = self._back_us + int(1e6 * self._random.expovariate(1 / (20 * CHANGE_S)))

    def poll_on(self) -> int | None:
        """Adapters are served by the clock."""
        return None

    def account(self) -> dict[str, Any]:
        """What was sent and what could not be."""
        return {"sent": self._sent, "lost": self.lost, "faults": self.faults}


class Converter:
    """A Modbus converter that counts its reads: function 4, registers 0 (counter) and on."""

    def __init__(self, task: dict[str, Any], path: Path, random: Random | None) -> None:
        self._terminal = Terminal(path)
        self._terminal.plug()
        self._unit = task["unit"]
        self._random = random
        self._came = b""
        self.reads = self.spoilt = 0

    def serve(self, elapsed_s: float) -> None:
        """Answer the requests that have come."""
        self._came += self._terminal.read()
        while len(self._came) >= IDENTIFY_BYTES:
            function = self._came[1]
            size = READ_BYTES if function == READ_INPUT else IDENTIFY_BYTES
            if len(self._came) < size:
                return
            request, self._came = self._came[:size], self._came[size:]
            if request[0] != self._unit:
                continue
            if function != READ_INPUT:
                self._terminal.write(_framed(bytes([self._unit, function | 0x80, 1])))
                continue
            self.reads += 1
            count = int.from_bytes(request[4:6], "big")
            values = [self.reads % 65_536, *(1000 + k for k in range(count - 1))]
            head = bytes([self._unit, function, 2 * count])
            frame = _framed(head + struct.pack(f">{count}H", *values))
            if self._random is not None and self._random.random() < 0.005:
                self.spoilt += 1
                frame = frame[:-1] + bytes([frame[-1] ^ 1])
            self._terminal.write(frame)

    def poll_on(self) -> int | None:
        """It answers at once."""
        return self._terminal.master

    def account(self) -> dict[str, Any]:
        """What was answered."""
        return {"reads": self.reads, "spoilt": self.spoilt}


def _framed(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def main() -> None:
    task = json.loads(sys.stdin.readline())
    folder = Path(task["folder"])
    random = Random(task["seed"]) if task["faults"] else None
    ends = {
        each["name"]: (Bus if "identifiers" in each else Converter)(
            each, folder / each["name"], random
        )
        for each in task["ports"]
    }
    poll = select.poll()
    poll.register(sys.stdin.fileno(), select.POLLIN | select.POLLHUP)
    for end in ends.values():
        if (descriptor := end.poll_on()) is not None:
            poll.register(descriptor, select.POLLIN)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    began = time.monotonic()
    tick = 0
    while True:
        wait_s = began + tick * TICK_S - time.monotonic()
        events = poll.poll(max(0.0, 1000 * wait_s))
        if any(descriptor == sys.stdin.fileno() for descriptor, _ in events):
            break
        elapsed_s = time.monotonic() - began
        served = {descriptor for descriptor, _ in events}
        due = elapsed_s >= tick * TICK_S
        for end in ends.values():
            if due or end.poll_on() in served:
                end.serve(elapsed_s)
        if due:
            tick = int(elapsed_s / TICK_S) + 1
    accounts = {name: end.account() for name, end in ends.items()}
    sys.stdout.write(json.dumps({"processor_s": time.process_time(), "ports": accounts}))


if __name__ == "__main__":
    main()
