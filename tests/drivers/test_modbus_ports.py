"""The Modbus link on ports of the operating system: missing, held by another, unplugged."""

from __future__ import annotations

import pytest

from drivers.driver import DeviceSpec
from drivers.errors import PortBusy, PortNotFound
from drivers.modbus.adc import AdcOptions, ModbusAdc
from drivers.modbus.link import ModbusLink
from recordings.events import Fault
from recordings.faults import FaultKind
from recordings.rig import SerialPort


@pytest.fixture
def adc(channel) -> ModbusAdc:
    options = AdcOptions.model_validate({"unit_id": 1, "channels": 1, "first_register": 0})
    return ModbusAdc(DeviceSpec("adc", "modbus-adc", "line", None, (channel("d1", 0),), options))


def port_at(path: str) -> SerialPort:
    return SerialPort(kind="serial", name="line", path=path)


def test_a_line_that_is_not_there(clock, adc, tmp_path):
    path = str(tmp_path / "nothing")
    with pytest.raises(PortNotFound, match=path):
        ModbusLink(port_at(path), [adc], clock).open()


def test_a_line_is_held_against_a_second_user(clock, adc, line):
    first, second = (ModbusLink(port_at(line.path), [adc], clock) for _ in range(2))
    first.open()
    with pytest.raises(PortBusy, match="in use"):
        second.open()
    first.close()
    second.open()
    second.close()


def test_a_real_port_that_is_unplugged(clock, adc, line):
    link = ModbusLink(port_at(line.path), [adc], clock)
    link.open()
    link.start(50.0)
    line.unplug()
    faults = []
    for _ in range(3):
        faults += [event.kind for event in link.pump(0.0) if isinstance(event, Fault)]
        clock.advance(0.02)
    link.close()
    assert faults == [FaultKind.BROKEN]
