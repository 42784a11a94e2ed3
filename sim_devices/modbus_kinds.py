"""Virtual Modbus converters, built from a rig. Options are those of the driver ``modbus-adc``."""

from __future__ import annotations

from typing import Any

from recordings.rig import Channel, Device, Rig
from sim_devices.crystal import crystal_of
from sim_devices.errors import DeviceNotSimulated
from sim_devices.modbus import MOST_READ, RtuServer
from sim_devices.modbus_adc import SETTINGS_START, AdcLayout, AdcRegisters, Cell
from sim_devices.modbus_tcp import TcpServer
from sim_devices.options import channels_of, number, option, text
from sim_devices.plant_seam import Plant

KINDS = ("uint16", "int16", "uint32", "int32", "float32")
ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")


def modbus_adc(rig: Rig, device: Device, plant: Plant) -> RtuServer:
    """A Modbus RTU converter. Options: ``unit_id`` 1..247, and its register map."""
    return RtuServer(option(device, "unit_id", 1, 247), _registers(rig, device, plant))


def modbus_tcp_adc(rig: Rig, device: Device, plant: Plant) -> TcpServer:
    """A Modbus TCP converter. Options: ``unit_id`` 0..255, and its register map."""
    return TcpServer(option(device, "unit_id", 0, 255), _registers(rig, device, plant))


def _registers(rig: Rig, device: Device, plant: Plant) -> AdcRegisters:
    layout = _layout(device)
    if not layout.fits:
        raise DeviceNotSimulated(
            f"the registers of '{device.name}' collide, or reach 0x{SETTINGS_START:04X}: signals, "
            f"counter and device time (behind the signals, where 'time_register' is absent) must "
            f"differ; they are {_shown(layout)}"
        )
    signals: dict[int | str, str] = {}
    for channel in channels_of(rig, device):
        signals[_signal(channel, device, layout)] = channel.name
    return AdcRegisters(layout, signals, plant, crystal_of(device.name))


def _layout(device: Device) -> AdcLayout:
    signals = _signals(device)
    order = _one_of(device, "order", ORDERS, "ABCD")
    counter = time = None
    if "counter_register" in device.options:
        address = option(device, "counter_register", 0, SETTINGS_START - 1)
        counter = Cell(address, _one_of(device, "counter_type", KINDS, "uint16"), order)
    if "time_register" in device.options:
        address = option(device, "time_register", 0, SETTINGS_START - 1)
        time = Cell(address, _one_of(device, "time_type", KINDS, "uint32"), order)
    behind = max(cell.addresses[-1] for cell in signals.values()) + 1
    return AdcLayout(
        signals=signals,
        time=Cell(behind, "uint32") if time is None else time,
        counter=counter,
        ticks_per_s=1e6 / option(device, "time_tick_us", 1, 1_000_000, 100),
        resolution=number(device, "resolution", 1.0),
    )


def _signals(device: Device) -> dict[int | str, Cell]:
    table: dict[str, dict[str, Any]] = device.options.get("signals", {})
    if table:
        return {
            name: Cell(each["address"], each.get("type", "uint16"), each.get("order", "ABCD"))
            for name, each in table.items()
        }
    channels = option(device, "channels", 1, MOST_READ)
    first = option(device, "first_register", 0, SETTINGS_START - 1)
    kind = _one_of(device, "type", KINDS, "uint16")
    order = _one_of(device, "order", ORDERS, "ABCD")
    width = len(Cell(0, kind).addresses)
    return {k: Cell(first + width * k, kind, order) for k in range(channels)}


def _signal(channel: Channel, device: Device, layout: AdcLayout) -> int | str:
    known = list(layout.signals)
    signal = channel.signal
    if signal is None or signal not in layout.signals:
        numbered = isinstance(known[0], int)
        expected = f"a number from 0 to {len(known) - 1}" if numbered else f"one of {known}"
        raise DeviceNotSimulated(
            f"channel '{channel.name}' has the signal {signal!r}, expected {expected}: "
            f"'{device.name}' has {len(known)} channels"
        )
    return signal


def _one_of(device: Device, key: str, known: tuple[str, ...], default: str) -> str:
    value = text(device, key, default)
    if value not in known:
        raise DeviceNotSimulated(
            f"option '{key}' of device '{device.name}' is '{value}', expected one of {', '.join(known)}"
        )
    return value


def _shown(layout: AdcLayout) -> str:
    return ", ".join(f"{cell.addresses[0]}..{cell.addresses[-1]}" for cell in layout.cells)
