"""The running bench: its time, its ports coming up and going down, its throughput."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path

import can
import pytest

from recordings.rig import Rig, parse_rig, rig_text
from sim_devices.bench import Bench, build_ports, run_bench, stop_on_signals
from sim_devices.errors import PortTaken, PortUnavailable
from sim_devices.faults.wiring import Wiring
from sim_devices.modbus import crc16
from tests.child_process import child_process

PATIENCE_S = 60.0


class HandClock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Recorder:
    """A port that notes when it was ticked; always ready, so that nothing waits."""

    name = address = "recorder"
    polled = True

    def __init__(self) -> None:
        self.ticks: list[float] = []
        self.serves: list[float] = []

    def open(self) -> None: ...

    def close(self) -> None: ...

    def fileno(self) -> None:
        return None

    def serve(self, time_s: float) -> None:
        self.serves.append(time_s)

    def tick(self, time_s: float) -> None:
        self.ticks.append(time_s)


def test_plant_and_devices_follow_the_clock(plant) -> None:
    clock, port = HandClock(), Recorder()
    bench = Bench([port], plant, clock)
    moved: list[float] = []
    plant.advance = moved.append
    with bench.opened():
        for now_s in (1000.0, 1000.0004, 1000.002, 1000.0051, 1000.0102, 1003.0, 1003.0055):
            clock.now_s = now_s
            bench.turn()
    assert [round(s, 4) for s in port.ticks] == [0.0, 0.0051, 0.0102, 3.0, 3.0055]
    assert len(port.serves) == 7
    assert [round(s, 4) for s in moved] == [0.0, 0.002, 0.0051, 0.0102, 3.0, 3.0055]


@pytest.mark.wires
@pytest.mark.usefixtures("no_leaks")
def test_ports_exist_while_the_bench_runs(arm_here: Rig, plant, running, tmp_path: Path) -> None:
    with running(arm_here, plant) as addresses:
        assert set(addresses) == {"arm-can", "arm-wrist"}
        assert all(Path(path).is_char_device() for path in addresses.values())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.wires
@pytest.mark.usefixtures("no_leaks")
def test_if_one_port_cannot_open_none_does(arm_here: Rig, plant, running, tmp_path: Path) -> None:
    (tmp_path / "loopcal-arm-wrist").write_text("taken")
    with pytest.raises(PortTaken, match="arm-wrist"), running(arm_here, plant):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["loopcal-arm-wrist"]


@pytest.mark.wires
def test_second_bench_on_the_same_paths_is_refused(arm_here: Rig, plant, running) -> None:
    with running(arm_here, plant) as addresses:
        with pytest.raises(PortTaken):
            run_bench(arm_here, plant, stop=threading.Event())
        assert all(Path(path).is_char_device() for path in addresses.values())


@pytest.mark.wires
def test_paths_can_be_given(plant, tmp_path: Path) -> None:
    rig = parse_rig(rig_text("shoulder")[0])
    stop = threading.Event()
    seen: list[bool] = []

    def ready(addresses) -> None:
        seen.append(Path(addresses["shoulder-adc"]).is_char_device())
        stop.set()

    run_bench(rig, plant, stop=stop, ports={"shoulder-adc": str(tmp_path / "a")}, ready=ready)
    assert seen == [True]


@pytest.mark.wires
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_bench_process_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    script = textwrap.dedent("""
        import sys
        from recordings.rig import load_rig
        from sim_devices.bench import run_bench, stop_on_signals

        class Nothing:
            def advance(self, time_s): ...
            def sense(self, channel): return 0
            def command(self, joint, mode, target_raw): ...
            def drive_fault(self, joint): return 0

        with stop_on_signals() as stop:
            run_bench(load_rig("shoulder"), Nothing(), stop=stop,
                      ports={"shoulder-adc": sys.argv[1]}, ready=lambda _: print("up", flush=True))
    """)
    path = tmp_path / "adc"
    with child_process(
        [sys.executable, "-c", script, str(path)], stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        assert path.is_char_device()
        process.send_signal(number)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert not path.is_symlink()


def test_devices_have_booted_before_a_host_is_let_in(shoulder_here: Rig, plant) -> None:
    stop, order = threading.Event(), []

    def ready(_addresses: Mapping[str, str]) -> None:
        order.append("ready")
        stop.set()

    run_bench(shoulder_here, plant, stop=stop, ready=ready, each_tick=lambda: order.append("tick"))
    assert order == ["tick", "ready"]


def test_signal_handlers_are_put_back() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.wait(PATIENCE_S)
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.fixture
def raw_host() -> Iterator[list[int]]:
    opened: list[int] = []
    yield opened
    for descriptor in opened:
        os.close(descriptor)


def exchange(descriptor: int, data: bytes, length: int) -> bytes:
    os.write(descriptor, data)
    got = b""
    while len(got) < length:
        assert select.select([descriptor], [], [], PATIENCE_S)[0], got
        got += os.read(descriptor, 65_536)
    return got


@pytest.mark.wires
def test_no_frame_is_lost_at_full_load(arm_here: Rig, plant, running, raw_host) -> None:
    # 400 SYNCs for 12 nodes, each as soon as the last was answered, beside Modbus polls.
    request = bytes.fromhex("01 04 00 00 00 05")
    request += crc16(request).to_bytes(2, "little")
    with running(arm_here, plant) as addresses:
        raw_host += [os.open(path, os.O_RDWR | os.O_NOCTTY) for path in addresses.values()]
        bus, line = raw_host
        assert exchange(bus, b"S8\rO\rt00020100\r", 4) == b"\r\rz\r"
        counters = []
        for _ in range(400):
            answer = exchange(bus, b"t0800\r", 2 + 5 * 22 + 7 * 16)
            frames = answer.split(b"\r")[1:-1]
            assert len(frames) == 12
            counters.append(int.from_bytes(bytes.fromhex(frames[0][13:17].decode()), "little"))
            assert len(exchange(line, request, 15)) == 15
    assert counters == list(range(1, 401))


@pytest.mark.wires
@pytest.mark.usefixtures("no_leaks")
def test_nodes_join_a_bus_of_another_interface(arm_here: Rig, plant, running, tmp_path) -> None:
    text = rig_text("arm")[0].replace("/tmp/", f"{tmp_path}/").replace('"slcan"', '"virtual"')
    plant.counts["q2"] = 42
    host = can.Bus(interface="virtual", channel=f"{tmp_path}/loopcal-arm-can")
    try:
        with running(parse_rig(text), plant):
            host.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
            host.send(can.Message(arbitration_id=0x80, is_extended_id=False))
            seen = {}
            while 0x197 not in seen:
                message = host.recv(PATIENCE_S)
                assert message is not None
                seen[message.arbitration_id] = bytes(message.data)
        assert seen[0x182][:6] == bytes.fromhex("2a 00 00 00 01 00")
    finally:
        host.shutdown()


def test_bus_that_cannot_be_joined_is_named(plant, tmp_path: Path) -> None:
    text = rig_text("arm")[0].replace('"slcan"', '"no-such-interface"')
    port = build_ports(parse_rig(text), Wiring(parse_rig(text), plant, 0), {})[0]
    with pytest.raises(PortUnavailable, match="no-such-interface:"):
        port.open()
