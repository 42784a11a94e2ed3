"""Virtual ports on TCP: one host after another, whole answers, a port that is taken."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator

import pytest

from sim_devices.errors import PortTaken, PortUnavailable
from sim_devices.tcp_port import MOST_WAITING, TcpServerPort
from tests.sim_devices.wires.echo import EchoLine

PATIENCE_S = 60.0

pytestmark = pytest.mark.usefixtures("no_leaks")


@pytest.fixture
def port(line: EchoLine) -> Iterator[TcpServerPort]:
    made = TcpServerPort("wire", "socket://127.0.0.1:0", line, b"hello ")
    made.open()
    yield made
    made.close()


def connect(port: TcpServerPort) -> socket.socket:
    host = socket.create_connection(("127.0.0.1", int(port.address.rpartition(":")[2])), PATIENCE_S)
    await_readable(port)
    port.serve(0.0)
    return host


def await_readable(port: TcpServerPort) -> None:
    descriptor = port.fileno()
    assert descriptor is not None
    assert select.select([descriptor], [], [], PATIENCE_S)[0]


def test_a_host_is_greeted_and_answered(port: TcpServerPort, line: EchoLine) -> None:
    with connect(port) as host:
        assert host.recv(100) == b"hello "
        host.sendall(b"abc")
        await_readable(port)
        port.serve(0.0)
        assert host.recv(100) == b"abc"
        line.due = b"unasked"
        port.tick(0.0)
        assert host.recv(100) == b"unasked"


def test_the_next_host_is_let_in_when_the_first_hangs_up(
    port: TcpServerPort, line: EchoLine
) -> None:
    with connect(port):
        pass
    await_readable(port)
    port.serve(0.0)
    assert line.hang_ups == 1
    line.due = b"nobody hears this"
    port.tick(0.0)
    with connect(port) as host:
        assert host.recv(100) == b"hello "


def test_a_host_that_does_not_read_loses_whole_answers(port: TcpServerPort, line: EchoLine) -> None:
    with connect(port):
        for _ in range(200):
            line.due = b"x" * MOST_WAITING
            port.tick(0.0)
        assert line.overruns > 0
        assert port.lost_bytes == line.overruns * MOST_WAITING


def test_it_comes_back_at_the_same_address(port: TcpServerPort) -> None:
    before = port.address
    port.close()
    port.close()
    assert port.fileno() is None
    port.open()
    assert port.address == before


def test_an_address_that_is_taken_or_none(port: TcpServerPort, line: EchoLine) -> None:
    with pytest.raises(PortTaken, match="cannot listen"):
        TcpServerPort("other", port.address, line).open()
    with pytest.raises(PortUnavailable, match="expected HOST:PORT"):
        TcpServerPort("other", "/tmp/somewhere", line).open()
