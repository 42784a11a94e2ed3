"""One device of each driver on a bench in memory, and what a fault script does to its readings.

The real driver reads real bytes; only the cable and the time are not real. A session is what a
capture does with a link, without its threads: pump, keep the ledger, look at the faults.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from daq.event_queue import Checkpoint
from daq.ledger import Ledger
from drivers import make_links
from drivers.detection import SAMPLE_HZ
from recordings.events import Event, Fault, LedgerEntry, Reading
from recordings.faults import Episode, episodes
from recordings.rig import Rig, parse_rig
from sim_devices.faults import Injector
from sim_devices.in_memory import MemoryBench
from sim_devices.virtual_time import START_NS, VirtualClock

STEP_S = 0.005
VOUCHED_S = 0.3
SECOND = 1_000_000_000

MECHANISM = """
schema = 1
name = "one device"
[mechanism]
family = "serial"
closure = { constraint = "rigid" }
[[mechanism.joint]]
name = "joint"
a_m = 0.3
[[mechanism.joint]]
name = "other"
a_m = 0.2
"""
CHANNEL = """
[[channel]]
name = "{name}"
senses = "{senses}"
device = "{device}"
{signal}
gain_deg_per_count = 0.01
count_range = [0, 1000000]
noise_counts = 2
"""
CAN = 'kind = "can"\ninterface = "slcan"\nchannel = "/tmp/no-such-can"'
TCP = 'kind = "tcp"\naddress = "127.0.0.1:502"'
SERIAL = 'kind = "serial"\npath = "/tmp/no-such-line"'
DRIVE = """
command = "DriveCommand"
status = "DriveStatus"
mode = "Mode"
reported_mode = "Shown"
modes = { off = 0, free = 1, position = 2, torque = 3 }
target_position = "Target"
target_torque = "Torque"
error = "Error"
"""
FILES = {"bench.dbc": Path(__file__).parents[1] / "drivers" / "bench.dbc"}


@dataclass(frozen=True, slots=True)
class Case:
    """How the device of one driver is described.

    Attributes:
        port: keys of its port.
        options: table of its options.
        driver: its driver, where the case has another name.
        signal: its channel's signal, "" where it has none.
        moves: whether it is a drive; an encoder then senses its joint.
        file: its DBC file, "" where it has none.
        streams: whether it samples by its own clock rather than when it is asked.
    """

    port: str
    options: str
    driver: str = ""
    signal: str = ""
    moves: bool = False
    file: str = ""
    streams: bool = False


CASES: Mapping[str, Case] = {
    "canopen-encoder": Case(CAN, "node_id = 3"),
    "canopen-joint": Case(CAN, "node_id = 17", moves=True),
    "canopen-listener": Case(CAN, "node_id = 17", moves=True),
    "dbc-encoder": Case(
        CAN,
        'counter = "Count"\nclock = "Time"\nclock_tick_us = 1000',
        signal='signal = "ElbowPosition.Angle"',
        file="bench.dbc",
        streams=True,
    ),
    "dbc-joint": Case(CAN, DRIVE + 'actual_position = "Actual"', moves=True, file="bench.dbc"),
    "dbc-listener": Case(CAN, DRIVE, moves=True, file="bench.dbc"),
    "modbus-adc": Case(
        SERIAL,
        "unit_id = 1\nchannels = 1\nfirst_register = 1\ncounter_register = 0\ntimeout_s = 0.1",
        signal="signal = 0",
    ),
    "modbus-adc over TCP": Case(
        TCP,
        "unit_id = 1\nchannels = 1\nfirst_register = 1\ncounter_register = 0\ntimeout_s = 0.1",
        driver="modbus-adc",
        signal="signal = 0",
    ),
    "cobs-adc": Case(
        SERIAL,
        'fields = ["sequence:u16", "time:u32", "x:i32"]\nsample_hz = 100',
        signal='signal = "x"',
        streams=True,
    ),
    "ascii-adc": Case(
        SERIAL,
        'pattern = "{sequence},{time},{x}"\nsequence_bits = 16\nsample_hz = 100',
        signal='signal = "x"',
        streams=True,
    ),
}
"""Of each driver (and kind of port), one device: the device under test is called "device", its port "port"."""


def rig_of(name: str) -> Rig:
    """A rig with the device of a case."""
    case = CASES[name]
    driver = case.driver or name
    text = MECHANISM + f'[[port]]\nname = "port"\n{case.port}\n'
    joint = 'joint = "joint"\n' if case.moves else ""
    file = f'file = "{case.file}"\n' if case.file else ""
    text += _device("device", driver, case.options, joint + file)
    if case.moves:
        text += _device("encoder", "canopen-encoder", "node_id = 3", "")
    sensor = "encoder" if case.moves else "device"
    text += CHANNEL.format(name="q", senses="joint", device=sensor, signal=case.signal)
    if case.file:
        text += f"[files]\n'{case.file}' = '''\n{FILES[case.file].read_text('utf-8')}'''\n"
    return parse_rig(text)


def _device(name: str, driver: str, options: str, more: str) -> str:
    return (
        f'[[device]]\nname = "{name}"\ndriver = "{driver}"\nport = "port"\n{more}'
        f"[device.options]\n{options}\n"
    )


class Noise:
    """Nature: joints that stand still, sensors with noise."""

    def __init__(self) -> None:
        self._random = random.Random(5)
        self.commands: list[tuple[str, str, int]] = []

    def advance(self, time_s: float) -> None: ...

    def sense(self, channel: str) -> int:
        return 20_000 + round(self._random.gauss(0.0, 2.0))

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        self.commands.append((joint, mode, target_raw))

    def drive_fault(self, joint: str) -> int:
        return 0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a session saw. Times in seconds since it began to sample.

    Attributes:
        faults: events, in order.
        episodes: the same from beginning to end.
        readings: times and flags of the readings of channel q.
        ledger: the balance of channel q.
        instants: samples that fell due.
        attempts: how often the port was opened.
        dropped: messages that the script took from the device.
    """

    faults: tuple[Fault, ...]
    episodes: tuple[Episode, ...]
    readings: tuple[tuple[float, int], ...]
    ledger: LedgerEntry
    instants: int
    attempts: int
    dropped: int

    def seconds(self, time_ns: int) -> float:
        """Time of a fault [s]."""
        return (time_ns - START_NS) / SECOND


def run(name: str, script: str, seconds: float) -> Outcome:
    """A session of ``seconds`` with the device of a case, while ``script`` happens."""
    rig, clock = rig_of(name), VirtualClock()
    bench = MemoryBench(rig, Noise(), clock, Injector(rig, script), seed=1)
    ledger, events = Ledger(), list[Event]()
    with bench.running():
        (link,) = make_links(bench.rig, clock)
        link.open()
        try:
            link.start(SAMPLE_HZ)
            began_s = clock.time_s
            while clock.time_s < seconds:
                for drive in link.joints.values():
                    drive.vouch(clock.now_ns() + round(VOUCHED_S * SECOND))
                events += link.pump(0.0)
                clock.advance(STEP_S)
            instants = math.floor((clock.time_s - began_s) * SAMPLE_HZ)
            link.stop()
            events += link.pump(0.0)
            losses = link.losses()
        finally:
            link.close()
        attempts = bench.attempts("port")
    readings = [event for event in events if isinstance(event, Reading)]
    for reading in readings:
        ledger.received(reading.channel)
    ledger.reach(Checkpoint(losses, {}), clock.now_ns())
    faults = tuple(event for event in events if isinstance(event, Fault))
    return Outcome(
        faults=faults,
        episodes=episodes(faults),
        readings=tuple(((r.time_ns - START_NS) / SECOND, int(r.flags)) for r in readings),
        ledger=ledger.entries["q"],
        instants=instants,
        attempts=attempts,
        dropped=bench.dropped("device"),
    )
