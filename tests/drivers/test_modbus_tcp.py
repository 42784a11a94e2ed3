"""Modbus TCP: replies proven by their transaction, and servers that others wrote."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus import FramerType
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.driver import DeviceSpec
from drivers.errors import Malformed
from drivers.link import Losses
from drivers.modbus.adc import AdcOptions, ModbusAdc
from drivers.modbus.link import ModbusLink
from drivers.modbus.mbap import Adu, AduBuffer, encode
from drivers.modbus.pdu import Identify, Read
from recordings.events import Fault, Reading
from recordings.faults import FaultKind
from recordings.rig import TcpPort
from tests.drivers.patience import PATIENCE_S

PORT = TcpPort(kind="tcp", name="line", address="10.0.0.5:502")


def test_a_request_is_read_by_pymodbus():
    """The example of the specification, 6.3: read holding registers 108 to 110."""
    frame = encode(Read(17, 3, 107, 3), 0x1501)
    assert frame == bytes.fromhex("1501 0000 0006 11 03 006B 0003")
    used, pdu = FramerSocket(DecodePDU(True)).handleFrame(frame, 17, 0x1501)
    assert used == len(frame)
    assert (pdu.address, pdu.count, pdu.dev_id) == (107, 3, 17)
    assert encode(Identify(1), 2)[7:] == bytes.fromhex("2B 0E 01 00")


@given(sizes=st.lists(st.integers(1, 9)))
def test_frames_are_whole_however_they_arrive(sizes):
    stream = bytes.fromhex("0001 0000 0005 11 04 02 0007") + bytes.fromhex(
        "0002 0000 0003 11 84 02"
    )
    buffer, frames, at = AduBuffer(), [], 0
    for size in [*sizes, len(stream)]:
        frames += buffer.feed(stream[at : at + size])
        at += size
    assert frames == [Adu(1, 17, b"\4\2\0\7"), Adu(2, 17, b"\x84\2")]


@pytest.mark.parametrize("head", ["0001 0001 0005 11", "0001 0000 0001 11", "0001 0000 00FF 11"])
def test_what_is_no_frame_ends_the_stream(head):
    with pytest.raises(Malformed, match="no head"):
        AduBuffer().feed(bytes.fromhex(head))


class Server:
    """A connection whose far end answers by a script: request frame and number to bytes."""

    def __init__(self, answer) -> None:
        self.answer = answer
        self.requests: list[bytes] = []
        self.opened = 0
        self._buffer = b""
        self._closed = False

    def connect(self, _port: TcpPort) -> Server:
        self.opened += 1
        self._buffer, self._closed = b"", False
        return self

    def settimeout(self, value) -> None:
        pass

    def sendall(self, data: bytes) -> None:
        self.requests.append(bytes(data))
        reply = self.answer(bytes(data), len(self.requests))
        if reply is None:
            self._closed = True
        else:
            self._buffer += reply

    def recv(self, size: int) -> bytes:
        if self._closed:
            return b""
        if not self._buffer:
            raise TimeoutError
        data, self._buffer = self._buffer[:size], self._buffer[size:]
        return data

    def close(self) -> None:
        pass


def reply_to(request: bytes, *registers: int, unit: int | None = None) -> bytes:
    body = b"".join(r.to_bytes(2, "big") for r in registers)
    pdu = bytes([request[7], len(body)]) + body
    unit = request[6] if unit is None else unit
    return request[:4] + (1 + len(pdu)).to_bytes(2, "big") + bytes([unit]) + pdu


@pytest.fixture
def make(clock, channel):
    links = []

    def make(server: Server) -> ModbusLink:
        options = {"unit_id": 255, "first_register": 0, "channels": 1, "timeout_s": 0.2}
        spec = DeviceSpec(
            "adc",
            "modbus-adc",
            "line",
            None,
            (channel("d1", 0),),
            AdcOptions.model_validate(options),
        )
        link = ModbusLink(PORT, [ModbusAdc(spec)], clock, server.connect)
        links.append(link)
        link.open()
        link.start(50.0)
        return link

    yield make
    for link in links:
        link.close()


def run(link, clock, steps: int) -> tuple[list[int], list[str]]:
    events = []
    for _ in range(steps):
        events += link.pump(0.0)
        clock.advance(0.02)
    raw = [e.raw for e in events if isinstance(e, Reading)]
    return raw, [e.kind for e in events if isinstance(e, Fault)]


def test_a_late_reply_is_never_taken_for_another_requests(make, clock):
    held: list[bytes] = []

    def answer(request: bytes, number: int) -> bytes:
        if number == 2:
            held.append(reply_to(request, 666))
            return b""
        late, held[:] = b"".join(held), []
        return late + reply_to(request, 100 + number)

    link = make(Server(answer))
    raw, kinds = run(link, clock, 4)
    assert raw == [101, 103, 104]
    assert kinds == [FaultKind.SILENT, FaultKind.ANSWERING, FaultKind.LATE]
    link.stop()
    assert link.losses()["d1"] == Losses(4, 1, 0, 0)


def test_replies_of_another_unit_or_length_are_not_taken(make, clock):
    def answer(request: bytes, number: int) -> bytes:
        if number == 2:
            return reply_to(request, 7, unit=3)
        return reply_to(request, *([1, 2] if number == 3 else [number]))

    raw, kinds = run(make(Server(answer)), clock, 4)
    assert raw == [1, 4]
    assert kinds[:3] == [FaultKind.SILENT, FaultKind.FOREIGN, FaultKind.MALFORMED]


@pytest.mark.parametrize("last", [None, b"\xff" * 12])
def test_a_connection_that_closes_or_speaks_another_protocol_is_opened_again(make, clock, last):
    server = Server(lambda request, number: last if number == 3 else reply_to(request, number))
    link = make(server)
    raw, kinds = run(link, clock, 30)
    assert kinds == [FaultKind.BROKEN, FaultKind.REOPENED]
    assert server.opened == 2
    assert raw[:3] == [1, 2, 4]
    link.stop()
    losses = link.losses()["d1"]
    assert losses.expected - len(raw) == losses.lost_in_gaps + losses.dropped_by_device


@pytest.fixture
def server_address() -> Iterator[str]:
    """A pymodbus server in a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    def call(coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(PATIENCE_S)

    async def serve() -> ModbusTcpServer:
        data = [
            SimData(address=10, values=[-70_000], datatype=DataType.INT32),
            SimData(address=12, values=[1.5], datatype=DataType.FLOAT32),
            SimData(address=14, values=[4711], datatype=DataType.REGISTERS),
        ]
        server = ModbusTcpServer(
            SimDevice(id=1, simdata=data), framer=FramerType.SOCKET, address=("127.0.0.1", 0)
        )
        await server.serve_forever(background=True)
        return server

    server = call(serve())
    host, number = server.transport.sockets[0].getsockname()
    yield f"{host}:{number}"
    call(server.shutdown())
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


def test_a_server_that_others_wrote(server_address, clock, channel, pump_until):
    signals = {
        "force": {"address": 10, "type": "int32"},
        "gap": {"address": 12, "type": "float32"},
        "plain": {"address": 14},
    }
    options = {
        "unit_id": 1,
        "signals": signals,
        "resolution": 0.25,
        "function": 3,
        "timeout_s": 10.0,
    }
    channels = tuple(channel(f"q-{name}", name) for name in signals)
    spec = DeviceSpec(
        "adc", "modbus-adc", "line", None, channels, AdcOptions.model_validate(options)
    )
    port = TcpPort(kind="tcp", name="line", address=server_address)
    link = ModbusLink(port, [ModbusAdc(spec)], clock)
    link.open()
    try:
        (status,) = link.check()
        assert status.answers, status.problem
        link.start(50.0)
        readings = [e for e in pump_until(link, Reading, 3) if isinstance(e, Reading)]
    finally:
        link.close()
    assert [r.raw for r in readings] == [-70_000, 6, 4711]
