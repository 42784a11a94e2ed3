"""A virtual arm behind a socketcand daemon: judged by python-can's own client, read by our driver."""

from __future__ import annotations

import itertools

import can
import pytest

from drivers import make_links
from recordings.events import Reading
from recordings.rig import Rig, parse_rig, rig_text
from sim_devices.can_bus import CanBus, Frame
from sim_devices.socketcand import SocketcandLine

PORTS = itertools.count(40_000)


class Echo:
    """Sends back each frame with its identifier plus one."""

    def receive(self, frame: Frame, time_s: float) -> list[Frame]:
        return [Frame(frame.identifier + 1, frame.data, frame.extended)]

    def tick(self, time_s: float) -> list[Frame]:
        return []


def test_the_words_of_the_daemon() -> None:
    line = SocketcandLine(CanBus([Echo()]), "can0")
    assert line.receive(b"< rawmode >", 0.0) == b"< error unknown command >"
    assert line.receive(b"< open can1 >", 0.0).startswith(b"< error")
    assert (
        line.receive(b"< op", 0.0) + line.receive(b"en can0 >< rawmode >", 0.0) == b"< ok >< ok >"
    )
    assert line.receive(b"< send 123 2 AB CD >", 1.5) == b"< frame 124 1.500000 ABCD >"
    assert line.receive(b"< send 00000123 0 >", 1.5) == b"< frame 00000124 1.500000  >"
    for wrong in (b"< send 900 0 >", b"< send 1 2 AB >", b"< send x 0 >", b"< nonsense >"):
        assert line.receive(wrong, 0.0) == b"< error unknown command >"
    line.hang_up()
    assert line.receive(b"< send 123 0 >", 0.0) == b"< error unknown command >"


@pytest.fixture
def rig() -> Rig:
    """The bundled arm, its CAN bus behind a daemon on a free port of this computer."""
    text = rig_text("arm")[0].replace('interface = "slcan"', 'interface = "socketcand"')
    return parse_rig(text.replace('"/tmp/loopcal-arm-can"', '"can0"'))


def at(rig: Rig, host: str, port: int) -> Rig:
    """``rig`` with its bus alone, at a daemon."""
    (bus, *_) = rig.ports
    moved = bus.model_copy(update={"options": {"host": host, "port": port}})
    devices = tuple(device for device in rig.devices if device.port == bus.name)
    return rig.model_copy(update={"ports": (moved,), "devices": devices})


@pytest.mark.wires
@pytest.mark.usefixtures("no_leaks")
def test_python_cans_client_and_ours(rig: Rig, plant, running) -> None:
    plant.counts = {f"q{n}": 100 * n for n in range(1, 8)}
    with running(at(rig, "127.0.0.1", 0), plant) as addresses:
        port = int(addresses["arm-can"].rpartition(":")[2])
        with can.Bus(interface="socketcand", channel="can0", host="127.0.0.1", port=port) as bus:
            bus.send(
                can.Message(
                    arbitration_id=0x601, data=b"\x40\x04\x60\0\0\0\0\0", is_extended_id=False
                )
            )
            answer = next(m for m in iter(lambda: bus.recv(5.0), None) if m.arbitration_id == 0x581)
            assert bytes(answer.data) == b"\x43\x04\x60\0\x64\0\0\0"
        here = at(rig, "127.0.0.1", port)

        class Clock:
            def now_ns(self) -> int:
                return next(self.times)

            times = itertools.count(0, 100_000)

        (link,) = make_links(here, Clock())
        link.open()
        try:
            assert all(status.answers and status.virtual for status in link.check())
            link.start(100.0)
            came: dict[str, int] = {}
            for _ in range(2000):
                came |= {e.channel: e.raw for e in link.pump(0.01) if isinstance(e, Reading)}
                if len(came) == 5:
                    break
            assert came == {f"q{n}": 100 * n for n in range(1, 6)}
        finally:
            link.close()
