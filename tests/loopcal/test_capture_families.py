"""Captures of the papers' mechanisms with other devices on them: each family, from device to recording."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from daq import CaptureOptions, CaptureSummary, Ending, HostClock, PlanNotPossible, capture
from drivers import make_links
from recordings.events import Mode
from recordings.reader import read_recording
from recordings.rig import Rig, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant
from sim_devices.running import running
from tests.child_process import child_process

pytestmark = pytest.mark.wires

SHOULDER_PORT = """
[[port]]
kind = "{kind}"
name = "shoulder-adc"
{where}

[[device]]
name = "lvdt-adc"
driver = "{driver}"
port = "shoulder-adc"
{more}
"""
SERIAL, TCP = ("serial", 'path = "/tmp/none"'), ("tcp", 'address = "127.0.0.1:0"')
CAN = ("can", 'interface = "slcan"\nchannel = "/tmp/none"')

LEGS_DBC = """VERSION ""

BS_:

BU_: HOST LEGS

BO_ 2147487744 Legs: 8 LEGS
 SG_ Leg1 : 7|12@0+ (0.029,0) [0|0] "mm" HOST
 SG_ Leg2 : 11|12@0+ (0.029,0) [0|0] "mm" HOST
 SG_ Leg3 : 31|12@0+ (0.029,0) [0|0] "mm" HOST
 SG_ Leg4 : 35|12@0+ (0.029,0) [0|0] "mm" HOST
 SG_ Count : 48|4@1+ (1,0) [0|0] "" HOST

BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 2147487744 10;
"""
SIGNALS: Mapping[str, tuple[tuple[str, str], str, str, str]] = {
    "modbus-tcp": (
        TCP,
        "modbus-adc",
        "options = { unit_id = 1, first_register = 100, channels = 4, type = 'int32', "
        "order = 'DCBA', counter_register = 98, counter_counts = 'reads', timeout_s = 0.5 }",
        "{n}",
    ),
    "cobs": (
        SERIAL,
        "cobs-adc",
        "options = { fields = ['sequence:u16', 'time:u32', 'leg0:u16', 'leg1:u16', 'leg2:u16', "
        "'leg3:u16'], crc = 'modbus', byte_order = 'big', sample_hz = 50 }",
        '"leg{n}"',
    ),
    "ascii": (
        SERIAL,
        "ascii-adc",
        "options = { pattern = '{leg0} {leg1} {leg2} {leg3}', sample_hz = 50 }",
        '"leg{n}"',
    ),
    "dbc": (CAN, "dbc-encoder", 'file = "legs.dbc"\noptions = { counter = "Count" }', '"Leg{m}"'),
}


def shoulder_with(family: str) -> str:
    """The bundled shoulder, its four legs read by another family of device; 4 poses."""
    text, _ = rig_text("shoulder")
    head, plan = text[: text.index("[[port]]")], text[text.index("[plan]") :]
    (kind, where), driver, more, signal = SIGNALS[family]
    for n in range(4):
        head = head.replace(f"signal = {n}\n", f"signal = {signal.format(n=n, m=n + 1)}\n")
    plan = plan.replace("poses = 100", "poses = 3")
    plan = plan.replace("poses = 10, visits = 3", "poses = 1, visits = 2")
    return head + SHOULDER_PORT.format(kind=kind, where=where, driver=driver, more=more) + plan


def written(folder: Path, text: str) -> tuple[Rig, str]:
    """A rig file with the DBC beside it, as a user has them; the rig and its text."""
    (folder / "legs.dbc").write_text(LEGS_DBC, "utf-8")
    (folder / "drives.dbc").write_text(DRIVES_DBC, "utf-8")
    (folder / "rig.toml").write_text(text, "utf-8")
    found, source = rig_text(str(folder / "rig.toml"))
    return parse_rig(found, source), found


def captured(rig: Rig, text: str, path: Path, wires: Path, **options) -> tuple:
    """Capture ``rig`` against its virtual devices; the summary and the recording."""
    clock = HostClock()
    with running(rig, make_plant(make_nature(rig, seed=3)), wires) as bench:
        links = make_links(rig, clock, bench.ports)
        summary = capture(
            rig, text, path, links=links, clock=clock, arm=lambda joints: True,
            options=CaptureOptions(**options),
        )  # fmt: skip
    return summary, read_recording(path)


@pytest.fixture
def wires(tmp_path: Path) -> Path:
    (tmp_path / "wires").mkdir()
    return tmp_path / "wires"


@pytest.mark.parametrize("family", SIGNALS)
def test_the_shoulder_read_by_other_devices(family, tmp_path, wires):
    rig, text = written(tmp_path, shoulder_with(family))
    summary, recording = captured(rig, text, tmp_path / "session.mcap", wires, max_duration_s=60.0)
    assert summary.ending is Ending.COMPLETE, (summary.why, summary.faults)
    assert len(summary.dwells) == 4
    for channel in rig.channels:
        readings, entry = recording.readings[channel.name], summary.ledger[channel.name]
        assert (entry.unaccounted, entry.received) == (0, len(readings.raw))
        assert entry.received >= 0.3 * entry.expected  # a busy computer may lose most
        for dwell in summary.dwells:
            inside = (readings.time_ns >= dwell.start_ns) & (readings.time_ns <= dwell.end_ns)
            counts = readings.raw[inside].astype(float)
            assert len(counts) >= 0.2 * rig.plan.dwell * rig.plan.sample
            assert np.std(counts) < 3.0 * channel.noise
            assert abs(np.mean(counts) - 2048) < 2048
    if family == "dbc":
        assert recording.rig.files == {"legs.dbc": LEGS_DBC}
        # The rig that the recording carries can be captured with again, wherever it is.
        assert make_links(parse_rig(recording.rig_toml), HostClock())


STATUSES = "".join(f'BA_ "GenMsgCycleTime" BO_ {0x510 + n} 40;\n' for n in range(1, 8))
DRIVES_DBC = (
    """VERSION ""

BS_:

BU_: HOST DRIVES
"""
    + "".join(
        f"""
BO_ {0x500 + n} Command{n}: 8 HOST
 SG_ Mode : 0|8@1+ (1,0) [0|0] "" DRIVES
 SG_ Target : 8|32@1- (1,0) [0|0] "" DRIVES
 SG_ Torque : 40|16@1- (1,0) [0|0] "" DRIVES

BO_ {0x510 + n} Status{n}: 8 DRIVES
 SG_ Shown : 0|8@1+ (1,0) [0|0] "" HOST
 SG_ Error : 8|8@1+ (1,0) [0|0] "" HOST
 SG_ Actual : 16|32@1- (1,0) [0|0] "" HOST
"""
        for n in range(1, 8)
    )
    + f"""
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
{STATUSES}"""
)
DRIVE_OPTIONS = """
file = "drives.dbc"
[device.options]
command = "Command{n}"
status = "Status{n}"
mode = "Mode"
reported_mode = "Shown"
modes = {{ off = 0, free = 1, position = 2, torque = 3 }}
reported_modes = {{ off = 0, free = 1, position = 2, torque = 3, fault = 9 }}
target_position = "Target"
target_torque = "Torque"
error = "Error"
{more}
"""


def arm_with_drives(driver: Callable[[int], tuple[str, str]]) -> str:
    """The bundled arm, its drives replaced: driver and rest of the table for each joint's number."""
    text, _ = rig_text("arm")
    for n in range(1, 8):
        old = (
            f'driver = "canopen-joint"\nport = "arm-can"\njoint = "joint{n}"\n'
            f"options = {{ node_id = {16 + n} }}\n"
        )
        assert old in text
        name, rest = driver(n)
        text = text.replace(
            old, f'driver = "{name}"\nport = "arm-can"\njoint = "joint{n}"\n{rest}\n'
        )
    # A busy computer answers late; this is about devices, not about its speed.
    text = text.replace("time_register = 3 }", "time_register = 3, timeout_s = 0.5 }")
    text = text.replace("sample_hz = 100", "sample_hz = 50")
    text = text.replace("[plan]", "[interlocks]\nsilence_s = 30\n\n[plan]")
    text = text.replace("poses = 60", "poses = 3")
    return text.replace("poses = 10, visits = 3", "poses = 1, visits = 2")


@contextmanager
def loopcal_sim(rig: Path, ports: Mapping[str, str]) -> Iterator[None]:
    """``loopcal sim`` in a process of its own, until its ports can be opened."""
    command = [sys.executable, "-m", "loopcal", "sim", str(rig)]
    command += [f"--port={name}={path}" for name, path in ports.items()]
    with child_process(command) as process:
        assert process.stdout is not None
        assert any(line.startswith("ready") for line in process.stdout)
        yield


def test_the_arm_driven_by_dbc_beside_canopen_encoders(tmp_path, wires, patient, until_complete):
    more = 'actual_position = "Actual"\ncycle_ms = 300'
    text = arm_with_drives(lambda n: ("dbc-joint", DRIVE_OPTIONS.format(n=n, more=more)))
    rig, text = written(tmp_path, text)
    clock = HostClock()
    ports = {port.name: str(wires / port.name) for port in rig.ports}

    def session(path: Path) -> CaptureSummary:
        with loopcal_sim(tmp_path / "rig.toml", ports):
            links = make_links(rig, clock, ports)
            return capture(rig, text, path, links=links, clock=clock, arm=lambda joints: True)

    summary = until_complete(session)
    recording = read_recording(summary.path)
    assert summary.ending is Ending.COMPLETE, (summary.why, summary.faults)
    assert len(summary.dwells) == 4
    assert all(entry.unaccounted == 0 for entry in summary.ledger.values())
    told = {(e.joint, e.mode) for e in recording.mode_commands}
    assert {(joint, Mode.POSITION) for joint in rig.plan.drives} <= told
    for joint in rig.plan.drives:
        assert [e.mode for e in recording.mode_reports if e.joint == joint][-1] is Mode.OFF


def test_an_arm_that_another_controller_moves_is_only_listened_to(tmp_path, wires):
    def driver(n: int) -> tuple[str, str]:
        if n == 5:
            return "dbc-listener", DRIVE_OPTIONS.format(n=n, more="")
        return "canopen-listener", f"options = {{ node_id = {16 + n} }}"

    text = arm_with_drives(driver)
    plan = text[text.index("[plan]") :]
    text = text.replace(
        plan,
        '[plan]\nmode = "by-hand"\nsample_hz = 100\nposes = 2\ndwell_s = 0.2\nsettle_s = 0.1\n'
        "revisit = { poses = 1, visits = 1 }\n",
    )
    for n in (1, 2, 3, 4, 6, 7):  # one joint is moved by the other controller
        text = text.replace(f'[[device]]\nname = "drive{n}"', f'[[gone]]\nname = "drive{n}"')
    text = "[[device]]".join(part for part in text.split("[[device]]") if part)
    while "[[gone]]" in text:
        start = text.index("[[gone]]")
        ends = [text.find(mark, start + 1) for mark in ("[[device]]", "[[gone]]", "\n#", "[plan]")]
        text = text[:start] + text[min(end for end in ends if end > 0) :]
    rig, text = written(tmp_path, text)
    every = {Mode.OFF, Mode.FREE, Mode.POSITION}
    for attempt in range(8):  # a computer that stands still may miss what is said meanwhile
        path = tmp_path / f"session-{attempt}.mcap"
        summary, recording = captured(rig, text, path, wires, max_duration_s=12.0)
        commands = [e for e in recording.mode_commands if e.joint == "joint5"]
        if every <= {e.mode for e in commands}:
            break
    assert summary.ending in (Ending.COMPLETE, Ending.STOPPED), (summary.why, summary.faults)
    assert every <= {e.mode for e in commands}
    assert all("another controller sent" in e.cause for e in commands)
    assert {Mode.POSITION} <= {e.mode for e in recording.mode_reports if e.joint == "joint5"}
    assert all(entry.unaccounted == 0 for entry in summary.ledger.values())


def test_a_plan_cannot_drive_what_is_only_listened_to(tmp_path):
    def driver(n: int) -> tuple[str, str]:
        kind = "canopen-listener" if n == 5 else "canopen-joint"
        return kind, f"options = {{ node_id = {16 + n} }}"

    rig, text = written(tmp_path, arm_with_drives(driver))
    with pytest.raises(PlanNotPossible, match="drives 'joint5', but its device only listens"):
        capture(rig, text, tmp_path / "session.mcap")
