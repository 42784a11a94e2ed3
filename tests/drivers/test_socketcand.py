"""A socketcand daemon that hesitates, babbles, refuses and dies."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.can_bus import EXTENDED, CanBus
from drivers.errors import LinkBroken, PortNotFound
from drivers.socketcand import ElementBuffer, SocketcandBus, decode, encode
from recordings.rig import CanPort
from tests.drivers.patience import PATIENCE_S


def test_frames_of_the_protocol_documentation():
    frame = decode(b"frame 123 23.424242 11 22 33 44")
    assert (frame.arbitration_id, bytes(frame.data)) == (0x123, b"\x11\x22\x33\x44")
    assert frame.timestamp == pytest.approx(23.424242)
    wide = decode(b"frame 1FFFFFFF 1.000000 AABB")
    assert (wide.is_extended_id, bytes(wide.data)) == (True, b"\xaa\xbb")
    assert decode(b"error 004 1.000000").is_error_frame
    message = can.Message(arbitration_id=0x123, data=b"\x11\x22", is_extended_id=False)
    assert encode(message) == b"< send 123 2 11 22 >"
    assert encode(can.Message(arbitration_id=1, is_extended_id=True)) == b"< send 00000001 0 >"


@pytest.mark.parametrize(
    "element",
    [b"frame 12 1.0 11", b"frame 123 1.0 1", b"frame 123 x 11", b"frame 900 1.0", b"hi", b"",
     b"frame 123 1.0 112233445566778899"],
)  # fmt: skip
def test_what_is_no_frame(element):
    assert decode(element) is None


@given(sizes=st.lists(st.integers(1, 9)))
def test_elements_are_whole_however_they_arrive(sizes):
    stream = b"< ok >garbage< frame 123 1.0 11 >< hi >"
    buffer, came, at = ElementBuffer(), [], 0
    for size in [*sizes, len(stream)]:
        came += buffer.feed(stream[at : at + size])
        at += size
    assert came == [b"ok", b"frame 123 1.0 11", b"hi"]


def test_babble_without_an_end_does_not_pile_up():
    buffer = ElementBuffer()
    assert sum(len(buffer.feed(b"x" * 100)) for _ in range(100)) > 30


Serve = Callable[[Callable[[socket.socket], None]], CanPort]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """A daemon that talks as a test says, in a thread; gives the port of the rig."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        threads = []

        def start(talk: Callable[[socket.socket], None]) -> CanPort:
            def run() -> None:
                host, _ = server.accept()
                with host:
                    talk(host)

            threads.append(threading.Thread(target=run))
            threads[-1].start()
            options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
            return CanPort(
                kind="can", name="bus", interface="socketcand", channel="can0", options=options
            )

        yield start
        for thread in threads:
            thread.join(PATIENCE_S)


def hear(host: socket.socket, words: bytes) -> None:
    came = b""
    while words not in came:
        came += host.recv(100)


def handshake(host: socket.socket) -> None:
    host.sendall(b"< hi >")
    hear(host, b"< open can0 >")
    host.sendall(b"< ok >")
    hear(host, b"< rawmode >")
    host.sendall(b"< ok >")


def test_frames_that_come_with_the_handshake_are_kept(serve, clock):
    def talk(host: socket.socket) -> None:
        host.sendall(b"< h")
        host.sendall(b"i >")
        hear(host, b"< open can0 >")
        host.sendall(b"< ok >< frame 111 1.0 01 >")
        hear(host, b"< rawmode >")
        host.sendall(b"< frame 112 1.0 02 >< ok >< frame 113 1.0 03 >")
        hear(host, b"< send 7FF 1 05 >")

    bus = CanBus(serve(talk), clock)
    bus.open()
    frames = [bus.receive(PATIENCE_S) for _ in range(3)]
    assert sorted(frame.identifier for frame in frames) == [0x111, 0x112, 0x113]
    bus.send(0x7FF, b"\5")
    bus.close()


def test_malformed_elements_are_counted_and_not_fatal(serve, clock):
    def talk(host: socket.socket) -> None:
        handshake(host)
        host.sendall(b"< frame 12 1.0 AA >< frame 123 1.0 0 >< frame 80000181x 1 >")
        host.sendall(b"< frame 00000181 1.0 AABB >")
        hear(host, b"< send")

    bus = CanBus(serve(talk), clock)
    bus.open()
    frame = bus.receive(PATIENCE_S)
    assert (frame.identifier, frame.data) == (0x181 | EXTENDED, b"\xaa\xbb")
    assert bus.malformed == 3
    bus.send(1, b"")
    bus.close()


def test_a_daemon_that_dies_is_noticed_at_once_and_does_not_spin(serve, clock, monkeypatch):
    bus = CanBus(serve(handshake), clock)
    bus.open()
    looks = 0
    wait_for = SocketcandBus._fill

    def look(self, timeout_s):
        nonlocal looks
        looks += 1
        return wait_for(self, timeout_s)

    monkeypatch.setattr(SocketcandBus, "_fill", look)
    with pytest.raises(LinkBroken, match="closed the connection"):
        bus.receive(PATIENCE_S)
    assert looks == 1
    bus.close()


@pytest.mark.parametrize(
    ("talk", "words"),
    [
        (lambda host: host.sendall(b"< hi >< error could not open bus >"), "could not open bus"),
        (lambda host: host.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n"), "closed the connection"),
    ],
)
def test_what_is_no_daemon_or_refuses(serve, clock, talk, words):
    bus = CanBus(serve(talk), clock)
    with pytest.raises(LinkBroken, match=words):
        bus.open()


def test_no_daemon_at_all(clock):
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    port = CanPort(
        kind="can", name="bus", interface="socketcand", channel="can0",
        options={"host": "127.0.0.1", "port": number},
    )  # fmt: skip
    with pytest.raises(PortNotFound, match="cannot reach"):
        CanBus(port, clock).open()


def test_it_times_out_without_a_frame(serve):
    done = threading.Event()

    def talk(host: socket.socket) -> None:
        handshake(host)
        done.wait(PATIENCE_S)

    port = serve(talk)
    bus = SocketcandBus("can0", **port.options)
    assert bus.recv(0.0) is None
    assert bus.recv(0.02) is None
    done.set()
    bus.shutdown()
