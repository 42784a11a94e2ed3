"""One small rig for each family of devices, as a user would describe it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from recordings.rig import Rig, parse_rig

DBC = (Path(__file__).parent / "bench.dbc").read_text("utf-8")
HZ = 100.0

HEAD = """
schema = 1
name = "contract"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "joint1"
a_m = 0.3
[[mechanism.joint]]
name = "joint2"
a_m = 0.2
[[channel]]
name = "q1"
senses = "joint1"
device = "{first}"
signal = {signal1}
gain_deg_per_count = 0.01
[[channel]]
name = "q2"
senses = "joint2"
device = "{second}"
signal = {signal2}
gain_deg_per_count = 0.01
"""
CAN = """
[[port]]
kind = "can"
name = "bus"
interface = "slcan"
channel = "/tmp/loopcal-contract-bus"
"""
SERIAL = """
[[port]]
kind = "serial"
name = "line"
path = "/tmp/loopcal-contract-line"
"""
TCP = """
[[port]]
kind = "tcp"
name = "line"
address = "127.0.0.1:0"
"""


@dataclass(frozen=True, slots=True)
class Family:
    """A family of devices.

    Attributes:
        text: its rig.
        counted: whether its readings carry a sample counter.
        timed: whether they carry device time.
        asked: whether it samples when it is asked, at the rate of the session.
    """

    text: str
    counted: bool = True
    timed: bool = True
    asked: bool = False

    @property
    def rig(self) -> Rig:
        """The rig, with the DBC of the tests where a device names it."""
        return parse_rig(self.text)


def _channels(first: str, signal1: str, second: str = "", signal2: str = "") -> str:
    return HEAD.format(
        first=first, second=second or first, signal1=signal1, signal2=signal2 or signal1
    )


_DBC_DRIVE = """
file = "bench.dbc"
[device.options]
command = "DriveCommand"
status = "DriveStatus"
mode = "Mode"
reported_mode = "Shown"
modes = { off = 0, free = 1, position = 2, torque = 3 }
target_position = "Target"
target_per_count = 2
target_at_zero = 100
target_torque = "Torque"
error = "Error"
"""
_FILES = f"\n[files]\n'bench.dbc' = '''\n{DBC}'''\n"
_DBC_SENSORS = """
[[device]]
name = "elbow"
driver = "dbc-encoder"
port = "bus"
file = "bench.dbc"
options = { counter = "Count", clock = "Time", clock_tick_us = 1000 }
[[device]]
name = "wrist"
driver = "dbc-encoder"
port = "bus"
file = "bench.dbc"
options = { cycle_ms = 10 }
"""

FAMILIES: Mapping[str, Family] = {
    "canopen": Family(
        _channels("encoder1", '"position"', "encoder2")
        + CAN
        + """
[[device]]
name = "encoder1"
driver = "canopen-encoder"
port = "bus"
options = { node_id = 1 }
[[device]]
name = "encoder2"
driver = "canopen-encoder"
port = "bus"
options = { node_id = 2 }
[[device]]
name = "drive1"
driver = "canopen-joint"
port = "bus"
joint = "joint1"
options = { node_id = 17 }
""",
        asked=True,
    ),
    "dbc": Family(
        _channels("elbow", '"ElbowPosition.Angle"', "wrist", '"Multiplexed.Wrist"')
        + CAN
        + _DBC_SENSORS
        + """
[[device]]
name = "drive1"
driver = "dbc-joint"
port = "bus"
joint = "joint1"
"""
        + _DBC_DRIVE
        + 'actual_position = "Actual"\ncounter = "Count"\n'
        + _FILES,
        counted=False,
        timed=False,
    ),
    "listeners": Family(
        _channels("elbow", '"ElbowPosition.Angle"', "wrist", '"Multiplexed.Wrist"')
        + CAN
        + "listen_only = true\n"
        + _DBC_SENSORS
        + """
[[device]]
name = "drive1"
driver = "dbc-listener"
port = "bus"
joint = "joint1"
"""
        + _DBC_DRIVE
        + """
[[device]]
name = "drive2"
driver = "canopen-listener"
port = "bus"
joint = "joint2"
options = { node_id = 40 }
"""
        + _FILES,
        counted=False,
        timed=False,
    ),
    "modbus-rtu": Family(
        _channels("adc", "0", signal2="1")
        + SERIAL
        + """
[[device]]
name = "adc"
driver = "modbus-adc"
port = "line"
[device.options]
unit_id = 1
first_register = 1
channels = 2
counter_register = 0
counter_counts = "reads"
time_register = 3
timeout_s = 0.5
""",
        asked=True,
    ),
    "modbus-tcp": Family(
        _channels("adc", '"x"', signal2='"y"')
        + TCP
        + """
[[device]]
name = "adc"
driver = "modbus-adc"
port = "line"
[device.options]
unit_id = 255
counter_register = 8
counter_type = "uint32"
counter_counts = "reads"
time_register = 20
order = "CDAB"
resolution = 0.25
timeout_s = 0.5
[device.options.signals]
x = { address = 10, type = "int32", order = "BADC" }
y = { address = 14, type = "float32" }
""",
        asked=True,
    ),
    "cobs": Family(
        _channels("adc", '"x"', signal2='"y"')
        + SERIAL
        + """
[[device]]
name = "adc"
driver = "cobs-adc"
port = "line"
[device.options]
fields = ["kind:u8=1", "flags:u8", "sequence:u16", "time:u32", "x:i32", "y:i32"]
sample_hz = 200
""",
    ),
    "ascii": Family(
        _channels("adc", '"x"', signal2='"y"')
        + SERIAL
        + """
[[device]]
name = "adc"
driver = "ascii-adc"
port = "line"
[device.options]
pattern = "{sequence},{time}; X={x} Y={y}"
sequence_bits = 16
sample_hz = 100
start_text = "go\\n"
stop_text = "halt\\n"
""",
    ),
}
