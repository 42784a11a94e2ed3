"""A rig is refused before any port is opened, in words that name the key."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints
from typing import Any

import pytest

from drivers import OptionError, driver_names, make_links, registry
from drivers.modbus import adc
from recordings.rig import load_rig, parse_rig

ONE_JOINT = """
schema = 1
name = "one"
[mechanism]
family = "serial"
[[mechanism.joint]]
name = "joint1"
[[mechanism.joint]]
name = "joint2"
"""

CHANNEL = """
[[channel]]
name = "{name}"
senses = "{senses}"
device = "{device}"
gain_deg_per_count = 0.001
{more}
"""

CAN = """
[[port]]
kind = "can"
name = "bus"
interface = "{interface}"
channel = "x"
"""

SERIAL = """
[[port]]
kind = "serial"
name = "line"
path = "/nowhere"
"""

DEVICE = """
[[device]]
name = "{name}"
driver = "{driver}"
port = "{port}"
options = {options}
{more}
"""


def rig(*parts: str):
    return parse_rig("".join([ONE_JOINT, *parts]))


def channel(name="q1", senses="joint1", device="e1", more="") -> str:
    return CHANNEL.format(name=name, senses=senses, device=device, more=more)


def device(name="e1", driver="canopen-encoder", port="bus", options="{ node_id = 1 }", more=""):
    return DEVICE.format(name=name, driver=driver, port=port, options=options, more=more)


def can(interface="virtual") -> str:
    return CAN.format(interface=interface)


def refusal(clock, *parts: str, overrides=None) -> str:
    with pytest.raises(OptionError) as caught:
        make_links(rig(*parts), clock, overrides)
    return str(caught.value)


ADC = "{ unit_id = 1, channels = 2, first_register = 1, counter_register = 0 }"


@pytest.mark.parametrize(
    ("name", "ports", "joints"),
    [("arm", ["arm-can", "arm-wrist"], 7), ("shoulder", ["shoulder-adc"], 0)],
)
def test_the_bundled_rigs_make_their_links(clock, name, ports, joints):
    links = make_links(load_rig(name), clock)
    assert [link.name for link in links] == ports
    assert sum(len(link.joints) for link in links) == joints


def test_links_are_made_for_ports_with_devices_only(clock):
    (link,) = make_links(rig(channel(), can(), SERIAL, device()), clock)
    assert link.name == "bus"
    assert set(link.losses()) == {"q1"}


def test_overrides_move_a_port(clock, tmp_path):
    missing = str(tmp_path / "moved")
    parts = (
        channel(device="a1", more="signal = 0"),
        SERIAL,
        device("a1", "modbus-adc", "line", ADC),
    )
    (link,) = make_links(rig(*parts), clock, {"line": missing})
    with pytest.raises(Exception, match=missing):
        link.open()
    assert "its ports: line" in refusal(clock, *parts, overrides={"lime": missing})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("{ }", ["device 'e1'", "missing key 'node_id'"]),
        ("{ node_id = 200 }", ["'node_id' is 200", "less than or equal to 127"]),
        ('{ node_id = "1" }', ["'node_id' is '1'", "integer"]),
        ("{ node_id = 1, nodeid = 2 }", ["unknown key 'nodeid'", "did you mean 'node_id'", "tpdo"]),
        ("{ node_id = 1, tpdo = 5 }", ["'tpdo' is 5"]),
    ],
)
def test_wrong_encoder_options(clock, options, words):
    text = refusal(clock, channel(), can(), device(options=options))
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("{ unit_id = 1, channels = 2 }", ["missing key 'first_register'"]),
        ("{ unit_id = 0, channels = 2, first_register = 1 }", ["'unit_id' is 0"]),
        (
            "{ unit_id = 1, channels = 2, first_register = 1, function = 6 }",
            ["'function' is 6", "3 or 4"],
        ),
        (
            "{ unit_id = 1, channels = 2, first_register = 1, counter_register = 2 }",
            ["register 2 is both signal 1 and 'counter_register'"],
        ),
        (
            "{ unit_id = 1, channels = 2, first_register = 1, counter_register = 900 }",
            ["registers 1 to 900 span 900"],
        ),
        ("{ unit_id = 1, channels = 2, first_register = 65535 }", ["register 65536"]),
        ("{ unit_id = 1, channels = 2, first_register = 1, timeout = 1.0 }", ["timeout_s"]),
        (
            "{ unit_id = 1, channels = 1, first_register = 1, order = 'BACD' }",
            ["'order' is 'BACD'"],
        ),
        ("{ unit_id = 1, channels = 1, first_register = 1, type = 'float32' }", ["'resolution'"]),
        (
            "{ unit_id = 1, first_register = 1, signals = { x = { address = 3 } } }",
            ["remove first_register"],
        ),
        (
            "{ unit_id = 1, signals = { x = { address = 3, type = 'int32' }, y = { address = 4 } } }",
            ["register 4 is both signal x and signal y"],
        ),
        ("{ unit_id = 1, signals = { x = { adress = 3 } } }", ["unknown key 'adress'"]),
        (
            "{ unit_id = 1, channels = 2, first_register = 1, timeout_s = 0 }",
            ["'timeout_s' is 0.0"],
        ),
    ],
)
def test_wrong_converter_options(clock, options, words):
    parts = (
        channel(device="a1", more="signal = 0"),
        SERIAL,
        device("a1", "modbus-adc", "line", options),
    )
    text = refusal(clock, *parts)
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            [channel(), can(), device(driver="canopen-encodr")],
            ["no driver 'canopen-encodr'", "modbus-adc"],
        ),
        ([channel(), can("vortual"), device()], ["'interface' is 'vortual'", "socketcan"]),
        ([channel(), SERIAL, device(port="line")], ["needs a port of kind 'can'", "'serial'"]),
        (
            [channel(more='signal = "speed"'), can(), device()],
            ["channel 'q1'", "'speed'", "position"],
        ),
        ([channel(), channel("q2", "joint2"), can(), device()], ["one signal", "q1, q2"]),
        ([channel(), can(), device(), device("e2")], ["'e1' and 'e2'", "node_id = 1"]),
        (
            [channel(device="a1"), SERIAL, device("a1", "modbus-adc", "line", ADC)],
            ["channel 'q1'", "'signal' is None", "0 to 1"],
        ),
        (
            [
                channel(device="a1", more="signal = 2"),
                SERIAL,
                device("a1", "modbus-adc", "line", ADC),
            ],
            ["'signal' is 2", "0 to 1"],
        ),
        (
            [
                channel(device="a1", more="signal = 0"),
                SERIAL,
                device("a1", "modbus-adc", "line", ADC),
                device("a2", "modbus-adc", "line", ADC),
            ],
            ["'a1' and 'a2'", "unit_id = 1"],
        ),
        (
            [channel(), can(), device(), device("d1", "canopen-joint", options="{ node_id = 2 }")],
            ["'d1'", "which 'joint'"],
        ),
        (
            [
                channel(device="d1"),
                can(),
                device("d1", "canopen-joint", options="{ node_id = 2 }", more='joint = "joint1"'),
            ],
            ["channel 'q1'", "delivers no channel"],
        ),
        (
            [
                channel(),
                can(),
                device(),
                device(
                    "d1",
                    "canopen-joint",
                    options="{ node_id = 2, master_id = 1 }",
                    more='joint = "joint1"',
                ),
            ],
            ["master_id = 1", "'e1'"],
        ),
        (
            [
                channel(),
                can(),
                device(),
                device(
                    "d1",
                    "canopen-joint",
                    options="{ node_id = 2, heartbeat_timeout_s = 0.1 }",
                    more='joint = "joint1"',
                ),
            ],
            ["'heartbeat_timeout_s' is 0.1", "0.3"],
        ),
        (
            [
                channel(),
                can(),
                device(),
                device("d1", "canopen-joint", options="{ node_id = 2 }", more='joint = "joint1"'),
                device(
                    "d2",
                    "canopen-joint",
                    options="{ node_id = 3, master_id = 9 }",
                    more='joint = "joint2"',
                ),
            ],
            ["disagree about master_id", "d1: 127", "d2: 9"],
        ),
    ],
)
def test_rigs_that_do_not_fit_their_drivers(clock, parts, words):
    text = refusal(clock, *parts)
    for word in words:
        assert word in text


def entry_points_of(monkeypatch, **drivers: str) -> None:
    found = EntryPoints(
        EntryPoint(n.replace("_", "-"), value, registry.GROUP) for n, value in drivers.items()
    )

    def entry_points(**wanted: Any) -> EntryPoints:
        return found.select(**wanted)

    monkeypatch.setattr(registry, "entry_points", entry_points)


def test_a_driver_from_an_entry_point_is_used(clock, monkeypatch):
    entry_points_of(monkeypatch, their_adc="drivers.modbus.adc:DRIVER")
    parts = (
        channel(device="a1", more="signal = 0"),
        SERIAL,
        device("a1", "their-adc", "line", ADC),
    )
    (link,) = make_links(rig(*parts), clock)
    assert set(link.losses()) == {"q1"}
    assert driver_names() == tuple(sorted([*registry.BUILT_IN, "their-adc"]))
    assert registry.find_driver("their-adc") is adc.DRIVER


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("drivers.nowhere:DRIVER", "cannot be loaded"),
        ("drivers.modbus.adc:ModbusAdc", "expected a drivers.driver.Driver"),
    ],
)
def test_an_entry_point_that_is_no_driver_is_named(monkeypatch, value, words):
    entry_points_of(monkeypatch, bad=value)
    with pytest.raises(OptionError, match=words):
        registry.find_driver("bad")


def test_drivers_of_different_links_cannot_share_a_port(clock, monkeypatch):
    other = adc.Driver(adc.AdcOptions, (adc.SerialPort,), adc.ModbusAdc, lambda *_: None)
    monkeypatch.setattr(adc, "OTHER", other, raising=False)
    entry_points_of(monkeypatch, other="drivers.modbus.adc:OTHER")
    second = device("a2", "other", "line", ADC.replace("unit_id = 1", "unit_id = 2"))
    parts = (
        channel(device="a1", more="signal = 0"),
        SERIAL,
        device("a1", "modbus-adc", "line", ADC),
        second,
    )
    assert "cannot share a port" in refusal(clock, *parts)
