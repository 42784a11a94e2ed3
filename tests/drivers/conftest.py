"""Peers on the other end of the drivers' wires, and a clock that moves when it is told to.

The CANopen peers are nodes of the ``canopen`` package, so that the drivers are judged by a
stack that is not theirs.
"""

from __future__ import annotations

import itertools
import os
import pty
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Iterator

import can
import canopen
import pytest
from canopen import objectdictionary as od

from drivers.can_bus import EXTENDED
from recordings.rig import CanPort, Channel, Quantity
from sim_devices.virtual_time import VirtualClock
from tests.drivers.patience import PATIENCE_S

SECOND = 1_000_000_000
_buses = itertools.count()


class Slave:
    """A CANopen node on a bus, answering by the package's own SDO server.

    ``objects`` maps (index, sub) to an integer of 4 bytes, or to a string.
    """

    def __init__(self, network: canopen.Network, node_id: int, objects: dict) -> None:
        self.network = network
        self.node_id = node_id
        self.commands: list[tuple[int, int]] = []
        self.node = canopen.LocalNode(node_id, _dictionary(objects))
        network.add_node(self.node)
        network.subscribe(0x000, lambda _id, data, _t: self.commands.append((data[0], data[1])))

    def on_sync(self, answer: Callable[[], None]) -> None:
        self.network.subscribe(0x080, lambda *_: answer())

    def send(self, cob_id: int, data: bytes) -> None:
        self.network.send_message(cob_id, data)

    @property
    def started(self) -> bool:
        return (1, self.node_id) in self.commands


def _dictionary(objects: dict) -> od.ObjectDictionary:
    dictionary = od.ObjectDictionary()
    records: dict[int, od.ODRecord] = {}
    subs = {index for index, sub in objects if sub}
    for (index, sub), value in objects.items():
        variable = od.ODVariable(f"object {index:04X}:{sub}", index, sub)
        variable.data_type = (
            od.VISIBLE_STRING if isinstance(value, str) else _SIZES[_size(index, sub)]
        )
        variable.access_type = "rw"
        variable.value = value
        if index in subs:
            if index not in records:
                records[index] = od.ODRecord(f"object {index:04X}", index)
                dictionary.add_object(records[index])
            records[index].add_member(variable)
        else:
            dictionary.add_object(variable)
    return dictionary


_SIZES = {1: od.UNSIGNED8, 2: od.UNSIGNED16, 4: od.UNSIGNED32}


def _size(index: int, sub: int) -> int:
    if index in (0x6060, 0x6061) or (0x1800 <= index < 0x1A00 and sub == 2):
        return 1
    return 2 if index in (0x6040, 0x6041, 0x603F, 0x6071) else 4


ENCODER = {(0x1000, 0): 0x00010196, (0x1008, 0): "loopcal virtual encoder", (0x6004, 0): 4711}


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def can_port() -> CanPort:
    channel = f"drivers-{os.getpid()}-{next(_buses)}"
    return CanPort(kind="can", name="bus", interface="virtual", channel=channel)


@pytest.fixture
def slaves(can_port: CanPort) -> Iterator[Callable[..., Slave]]:
    """Adds slaves to the bus of ``can_port``."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.02
    network.connect(interface="virtual", channel=can_port.channel)
    yield lambda node_id, objects: Slave(network, node_id, objects)
    network.disconnect()


class FakeBus:
    """A python-can bus that gives what a test pushes, keeps what is sent, and can be unplugged.

    ``answer`` is called with each message that is sent; ``attempts`` counts how often it was
    opened.
    """

    def __init__(self) -> None:
        self.plugged = True
        self.attempts = 0
        self.sent: list[can.Message] = []
        self.incoming: deque[can.Message] = deque()
        self.answer: Callable[[can.Message], None] = lambda message: None

    def connect(self, _port: CanPort) -> FakeBus:
        self.attempts += 1
        if not self.plugged:
            raise FileNotFoundError(2, "No such file or directory")
        return self

    def push(self, identifier: int, data: bytes) -> None:
        extended = bool(identifier & EXTENDED)
        self.incoming.append(
            can.Message(arbitration_id=identifier & ~EXTENDED, data=data, is_extended_id=extended)
        )

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self.plugged:
            raise OSError(5, "Input/output error")
        if not self.incoming:
            threading.Event().wait(min(timeout or 0.0, 0.001))
        return self.incoming.popleft() if self.incoming else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if not self.plugged:
            raise OSError(5, "Input/output error")
        self.sent.append(msg)
        self.answer(msg)

    def shutdown(self) -> None:
        pass


@pytest.fixture
def bus() -> FakeBus:
    return FakeBus()


class PtyPeer:
    """The far end of a serial line."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        self.path = os.ttyname(slave)
        # Kept open, so that the line does not hang up while nobody has it open.
        self._slave = slave

    def read(self, timeout_s: float = PATIENCE_S) -> bytes:
        """What came, waiting for the first byte."""
        ready, _, _ = select.select([self.master], [], [], timeout_s)
        return os.read(self.master, 4096) if ready else b""

    def read_until(self, end: bytes) -> bytes:
        deadline = time.monotonic() + PATIENCE_S
        came = b""
        while not came.endswith(end) and time.monotonic() < deadline:
            came += self.read(0.05)
        return came

    def write(self, data: bytes) -> None:
        # A process that is stopped meanwhile may write a part only.
        while data:
            data = data[os.write(self.master, data) :]

    def unplug(self) -> None:
        for fd in (self.master, self._slave):
            if fd >= 0:
                os.close(fd)
        self.master = self._slave = -1


@pytest.fixture
def line() -> Iterator[PtyPeer]:
    peer = PtyPeer()
    yield peer
    peer.unplug()


@pytest.fixture(autouse=True)
def _no_thread_leaks() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    left = [thread.name for thread in threading.enumerate() if thread not in before]
    assert not left, f"threads left behind: {left}"


@pytest.fixture
def channel() -> Callable[..., Channel]:
    """Makes channels: a gain and a place are needed, and mean nothing to a driver."""

    def make(name: str, signal: str | int | None = None, **more: object) -> Channel:
        gain = Quantity(1e-5, "angle/count")
        return Channel.model_construct(name=name, senses="joint1", signal=signal, gain=gain, **more)

    return make


@pytest.fixture
def pump_until() -> Callable[..., list]:
    """Pumps a link until enough of an event kind came; fails after `PATIENCE_S` of real time."""

    def pump(link, kind: type, count: int = 1, step: Callable[[], None] = lambda: None) -> list:
        deadline = time.monotonic() + PATIENCE_S
        came: list = []
        while sum(isinstance(event, kind) for event in came) < count:
            assert time.monotonic() < deadline, f"expected {count} {kind.__name__}, got {came}"
            step()
            came.extend(link.pump(0.02))
        return came

    return pump
