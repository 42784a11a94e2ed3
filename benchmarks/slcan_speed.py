"""Full CAN buses through a pseudo-terminal, read by three slcan buses side by side:

    python benchmarks/slcan_speed.py [--seconds 5] [--rate 9000]

A process of its own writes slcan frames of 8 bytes at a steady rate, as an adapter on a full bus
of 1 Mbit/s does (7,400 to 9,000 frames/s), with or without time stamps, and does not wait: what
finds no room is lost. Each bus reads them in turn: python-can's own slcan, loopcal's plug-in, and
the plug-in with time stamps. Frames carry their number, so that a loss is seen wherever it
happens. Printed: frames sent, received, lost, and processor time of the reader by frame, also as a
ratio to python-can's.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import pty
import time
import tty
from multiprocessing.connection import Connection

import can
from monte_carlo import console
from rich.progress import track
from rich.table import Table

TICK_S = 0.002
QUIET_S = 1.0


def feed(master: int, rate: int, seconds: float, stamped: bool, done: Connection) -> None:
    """Write frames at ``rate`` to the terminal; tells how many there were to send."""
    os.set_blocking(master, False)
    started = time.monotonic()
    sent = 0
    while (elapsed_s := time.monotonic() - started) < seconds:
        due = int(elapsed_s * rate)
        stamp = f"{int(elapsed_s * 1000) % 60_000:04X}" if stamped else ""
        lines = "".join(f"t1238{number:016X}{stamp}\r" for number in range(sent, due))
        data = lines.encode()
        try:
            written = os.write(master, data) if data else 0
        except BlockingIOError:
            written = 0
        if 0 < written < len(data) and not data[:written].endswith(b"\r"):
            # A frame that was cut off would spoil the next one too.
            os.set_blocking(master, True)
            rest = data[written:]
            os.write(master, rest[: rest.index(b"\r") + 1])
            os.set_blocking(master, False)
        sent = due
        time.sleep(TICK_S)
    done.send(sent)


def measure(interface: str, rate: int, seconds: float, stamped: bool) -> tuple[int, int, float]:
    """Frames sent and received, and processor time of the reader [s]."""
    master, slave = pty.openpty()
    tty.setraw(master)
    options = {"sleep_after_open": 0.0, "bitrate": 1_000_000, "channel": os.ttyname(slave)}
    here, there = multiprocessing.Pipe(duplex=False)
    with can.Bus(interface=interface, **options) as bus:
        feeder = multiprocessing.Process(target=feed, args=(master, rate, seconds, stamped, there))
        feeder.start()
        seen: set[int] = set()
        used = time.process_time()
        while True:
            try:
                message = bus.recv(QUIET_S)
            except ValueError:  # a frame that was cut by an overrun
                continue
            if message is None:
                break
            if len(message.data) == 8:
                seen.add(int.from_bytes(message.data, "big"))
        used = time.process_time() - used
        sent = here.recv()
        feeder.join()
    os.close(master)
    os.close(slave)
    return sent, len(seen), used


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    parser.add_argument("--rate", type=int, default=9000, help="frames a second")
    given = parser.parse_args()
    cases = (
        ("python-can slcan", "slcan", False),
        ("loopcal-slcan", "loopcal-slcan", False),
        ("loopcal-slcan, time stamps", "loopcal-slcan", True),
    )
    table = Table("bus", "sent", "received", "lost", "µs a frame", "ratio", box=None)
    first = 0.0
    for name, interface, stamped in track(cases, "reading", console=console, transient=True):
        sent, received, used = measure(interface, given.rate, given.seconds, stamped)
        each = 1e6 * used / max(received, 1)
        first = first or each
        lost = f"{100 * (sent - received) / max(sent, 1):.2f} %"
        table.add_row(
            name, f"{sent:,}", f"{received:,}", lost, f"{each:.1f}", f"{each / first:.2f}"
        )
    console.print(f"{given.rate:,} frames/s for {given.seconds:g} s through a pseudo-terminal")
    console.print(table)


if __name__ == "__main__":
    main()
