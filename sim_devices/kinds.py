"""Which virtual device answers to which driver name of a rig, and how it is built from the rig.

A kind is one function in `CAN_KINDS` or `SERIAL_KINDS`; to add a kind, add its function. The
options are those of the driver of the same name; only what concerns the wire is read here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from recordings.rig import CanPort, Channel, Device, Rig, SerialPort
from sim_devices.can_bus import CanBus, CanNode
from sim_devices.canopen import Encoder, JointDrive
from sim_devices.crystal import crystal_of
from sim_devices.errors import DeviceNotSimulated
from sim_devices.line import SerialDevice, SerialLine
from sim_devices.modbus import MOST_READ, RtuServer
from sim_devices.modbus_adc import SETTINGS_START, AdcLayout, AdcRegisters
from sim_devices.plant_seam import Plant

Make = Callable[[Rig, Device, Plant], Any]


def canopen_encoder(rig: Rig, device: Device, plant: Plant) -> Encoder:
    """A CiA 406 encoder. Options: ``node_id`` 1..127."""
    channels = _channels(rig, device)
    if len(channels) != 1:
        raise DeviceNotSimulated(
            f"the encoder '{device.name}' delivers {len(channels)} channels of the rig, "
            f'expected one channel with device = "{device.name}"'
        )
    node_id = _option(device, "node_id", 1, 127)
    return Encoder(node_id, device.name, channels[0], plant, crystal_of(device.name))


def canopen_joint(rig: Rig, device: Device, plant: Plant) -> JointDrive:
    """A CiA 402 drive. Options: ``node_id`` 1..127."""
    if device.joint is None:
        raise DeviceNotSimulated(
            f"the drive '{device.name}' moves no joint; give the device a 'joint'"
        )
    channel = rig.sensed_by(device.joint)
    if channel is None:
        raise DeviceNotSimulated(
            f"the drive '{device.name}' moves '{device.joint}', which no channel senses; "
            f"a virtual drive needs the counts of one"
        )
    node_id = _option(device, "node_id", 1, 127)
    return JointDrive(node_id, device.name, device.joint, channel, plant)


def modbus_adc(rig: Rig, device: Device, plant: Plant) -> RtuServer:
    """A Modbus RTU converter.

    Options: ``unit_id`` 1..247, ``channels``, ``first_register``, ``counter_register`` (none
    where absent).
    """
    counter: int | None = None
    if "counter_register" in device.options:
        counter = _option(device, "counter_register", 0, SETTINGS_START - 1)
    layout = AdcLayout(
        channels=_option(device, "channels", 1, MOST_READ),
        first_register=_option(device, "first_register", 0, SETTINGS_START - 1),
        counter_register=counter,
    )
    if not layout.fits:
        raise DeviceNotSimulated(
            f"the registers of '{device.name}' collide: counter at {layout.counter_register}, "
            f"{layout.channels} counts from {layout.first_register}, device time in the two after "
            f"them; they must differ and lie below 0x{SETTINGS_START:04X}"
        )
    signals: dict[int, str] = {}
    for channel in _channels(rig, device):
        if not isinstance(channel.signal, int) or not 0 <= channel.signal < layout.channels:
            raise DeviceNotSimulated(
                f"channel '{channel.name}' has the signal {channel.signal!r}, expected a number "
                f"from 0 to {layout.channels - 1}: '{device.name}' has {layout.channels} channels"
            )
        signals[channel.signal] = channel.name
    return RtuServer(
        _option(device, "unit_id", 1, 247),
        AdcRegisters(layout, signals, plant, crystal_of(device.name)),
    )


CAN_KINDS: dict[str, Callable[[Rig, Device, Plant], CanNode]] = {
    "canopen-encoder": canopen_encoder,
    "canopen-joint": canopen_joint,
}
SERIAL_KINDS: dict[str, Callable[[Rig, Device, Plant], SerialDevice]] = {
    "modbus-adc": modbus_adc,
}


Place = Callable[[Device, Callable[[Device], Any]], Any]
"""Puts at the place of a device what the function makes of it."""


def directly(device: Device, make: Callable[[Device], Any]) -> Any:
    """The device itself, with nothing around it."""
    return make(device)


def can_bus(rig: Rig, port: CanPort, plant: Plant, place: Place = directly) -> CanBus:
    """The virtual nodes on a CAN port; raises DeviceNotSimulated."""
    return CanBus(_build(rig, port.name, plant, CAN_KINDS, "node_id", place))


def serial_line(rig: Rig, port: SerialPort, plant: Plant, place: Place = directly) -> SerialLine:
    """The virtual devices on a serial port; raises DeviceNotSimulated."""
    return SerialLine(_build(rig, port.name, plant, SERIAL_KINDS, "unit_id", place))


def _build(
    rig: Rig, port: str, plant: Plant, kinds: Mapping[str, Make], address: str, place: Place
) -> list[Any]:
    built: list[Any] = []
    owners: dict[Any, str] = {}
    for device in (device for device in rig.devices if device.port == port):
        make = kinds.get(device.driver)
        if make is None:
            raise DeviceNotSimulated(
                f"device '{device.name}' on port '{port}' has the driver '{device.driver}', for "
                f"which there is no virtual device; there are: {', '.join(sorted(kinds))}"
            )
        built.append(place(device, partial(_built, rig, plant, make)))
        number = device.options.get(address)
        if number in owners:
            raise DeviceNotSimulated(
                f"'{owners[number]}' and '{device.name}' on port '{port}' both have "
                f"{address} = {number}; addresses on one port must differ"
            )
        owners[number] = device.name
    return built


def _built(rig: Rig, plant: Plant, make: Make, device: Device) -> Any:
    return make(rig, device, plant)


def _channels(rig: Rig, device: Device) -> list[Channel]:
    return [channel for channel in rig.channels if channel.device == device.name]


def _option(device: Device, key: str, low: int, high: int) -> int:
    value = device.options.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        found = "missing" if value is None else repr(value)
        raise DeviceNotSimulated(
            f"option '{key}' of device '{device.name}' is {found}, expected {low} to {high}"
        )
    return value
