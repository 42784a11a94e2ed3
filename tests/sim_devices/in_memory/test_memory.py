"""Ports in memory, as pyserial and sockets see them."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest
import serial

from sim_devices.errors import PortTaken
from sim_devices.faults import Injector
from sim_devices.in_memory import MemoryBench
from sim_devices.in_memory.port import SCHEME, TCP_HOST, MemoryPort
from sim_devices.in_memory.tcp import connections_in_memory
from sim_devices.virtual_time import VirtualClock, time_is
from tests.faults.bench import Noise, rig_of

ADDRESS = f"{SCHEME}://test/line"


class Far:
    """Answers in capitals, and says "tick" a second after it was asked to."""

    def __init__(self) -> None:
        self.hung_up = 0
        self.overruns = 0
        self.said: list[bytes] = []

    def receive(self, data: bytes, time_s: float) -> bytes:
        return data.upper()

    def tick(self, time_s: float) -> bytes:
        said, self.said = b"".join(self.said), []
        return said

    def hang_up(self) -> None:
        self.hung_up += 1

    def overrun(self) -> None:
        self.overruns += 1


@pytest.fixture
def far() -> Far:
    return Far()


@pytest.fixture
def port(far: Far, monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryPort]:
    packages = [*serial.protocol_handler_packages, "sim_devices.in_memory"]
    monkeypatch.setattr(serial, "protocol_handler_packages", packages)
    port = MemoryPort("line", ADDRESS, far)
    port.on_written = lambda: port.serve(0.0)
    port.open()
    yield port
    port.close()


def test_a_host_writes_and_reads(port: MemoryPort) -> None:
    with serial.serial_for_url(ADDRESS, timeout=0.0) as host:
        host.write(b"abc")
        assert host.in_waiting == 3
        assert host.read(2) == b"AB"
        host.reset_input_buffer()
        assert host.read(2) == b""


def test_a_read_waits_for_its_timeout_and_no_longer(port: MemoryPort, far: Far) -> None:
    clock = VirtualClock()
    with time_is(clock), clock.calling(0.005, port.tick):
        host = serial.serial_for_url(ADDRESS, timeout=0.5)
        assert host.read(1) == b""
        assert clock.time_s == pytest.approx(0.5, abs=0.002)
        far.said.append(b"hello")
        assert host.read(5) == b"hello"
        assert clock.time_s < 0.52
        host.close()


def test_a_port_has_one_host_at_a_time_and_hears_it_go(port: MemoryPort, far: Far) -> None:
    host = serial.serial_for_url(ADDRESS)
    with pytest.raises(serial.SerialException, match="could not open"):
        serial.serial_for_url(ADDRESS)
    host.close()
    assert far.hung_up == 1
    serial.serial_for_url(ADDRESS).close()
    with pytest.raises(serial.PortNotOpenError):
        host.read(1)


def test_a_port_that_goes_away_breaks_its_host(port: MemoryPort) -> None:
    host = serial.serial_for_url(ADDRESS, timeout=0.0)
    port.close()
    for use in (lambda: host.read(1), lambda: host.write(b"x"), lambda: host.in_waiting):
        with pytest.raises(OSError, match="Input/output error"):
            use()
    host.close()
    with pytest.raises(serial.SerialException) as caught:
        serial.serial_for_url(ADDRESS)
    assert "No such file" in str(caught.value)


def test_an_address_belongs_to_one_port(port: MemoryPort, far: Far) -> None:
    with pytest.raises(PortTaken):
        MemoryPort("other", ADDRESS, far).open()


def test_a_host_that_does_not_read_loses_whole_answers(port: MemoryPort, far: Far) -> None:
    host = serial.serial_for_url(ADDRESS, timeout=0.0)
    for _ in range(10):
        host.write(bytes(10_000))
    assert host.in_waiting % 10_000 == 0
    assert port.lost_bytes == 100_000 - host.in_waiting
    assert far.overruns == port.lost_bytes // 10_000
    host.close()


def test_a_connection_waits_times_out_and_ends(far: Far) -> None:
    port = MemoryPort("line", f"{TCP_HOST}:1", far)
    port.on_written = lambda: port.serve(0.0)
    port.open()
    clock = VirtualClock()
    with time_is(clock), connections_in_memory():
        host = socket.create_connection((TCP_HOST, 1), 1.0)
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        host.sendall(b"abc")
        assert host.recv(10) == b"ABC"
        host.settimeout(0.25)
        with pytest.raises(TimeoutError):
            host.recv(10)
        assert clock.time_s == pytest.approx(0.25, abs=0.002)
        port.close()
        assert host.recv(10) == b""
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((TCP_HOST, 1), 1.0)
        host.close()


def test_other_addresses_are_opened_as_ever() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        connections_in_memory(),
        socket.create_connection(server.getsockname(), 5.0) as host,
    ):
        assert isinstance(host, socket.socket)


def test_a_bench_leaves_nothing_behind() -> None:
    before = list(serial.protocol_handler_packages), time.monotonic, socket.create_connection
    rig = rig_of("modbus-adc")
    bench = MemoryBench(rig, Noise(), VirtualClock(), Injector(rig))
    with bench.running():
        host = serial.serial_for_url(bench.rig.ports[0].path)
        assert bench.attempts("port") == 1
    with pytest.raises(OSError, match="Input/output"):
        host.read(1)
    host.close()
    after = list(serial.protocol_handler_packages), time.monotonic, socket.create_connection
    assert after == before
