"""The Modbus driver reads a slave that others wrote: pymodbus's server, RTU frames over TCP."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers import make_links
from drivers.link import Losses
from recordings.events import Reading
from recordings.rig import parse_rig
from tests.drivers.patience import PATIENCE_S

RIG = """
schema = 1
name = "one"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "joint1"
[[mechanism.joint]]
name = "joint2"
[[channel]]
name = "q1"
senses = "joint1"
device = "adc"
signal = 0
gain_deg_per_count = 0.001
[[channel]]
name = "q2"
senses = "joint2"
device = "adc"
signal = 2
gain_deg_per_count = 0.001
[[port]]
kind = "serial"
name = "line"
path = "socket://127.0.0.1:1"
[[device]]
name = "adc"
driver = "modbus-adc"
port = "line"
options = { unit_id = 5, channels = 3, first_register = 10, function = 3, timeout_s = 10.0 }
"""


@pytest.fixture
def server_url() -> Iterator[str]:
    """A pymodbus server in a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    def run(coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(PATIENCE_S)

    async def serve() -> ModbusTcpServer:
        registers = SimData(address=10, values=[111, 222, 333], datatype=DataType.REGISTERS)
        device = SimDevice(id=5, simdata=[registers])
        server = ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        return server

    server = run(serve())
    host, port = server.transport.sockets[0].getsockname()
    yield f"socket://{host}:{port}"
    run(server.shutdown())
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


def test_pymodbus_server(server_url, clock, pump_until):
    (link,) = make_links(parse_rig(RIG), clock, {"line": server_url})
    link.open()
    try:
        (status,) = link.check()
        assert status.answers, status.problem
        assert status.channels == ("q1", "q2")
        link.start(100.0)
        events = []
        for _ in range(3):
            events += pump_until(link, Reading, 2)
            clock.advance(0.01)
        link.stop()
    finally:
        link.close()
    assert [(e.channel, e.raw) for e in events] == [("q1", 111), ("q2", 333)] * 3
    assert link.losses()["q1"] == Losses(3, 0, 0, 0)
