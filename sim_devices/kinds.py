"""Which virtual device answers to which driver name of a rig, and how it is built from the rig.

A kind is one function in `CAN_KINDS`, `SERIAL_KINDS` or `TCP_KINDS`; to add a kind, add its
function. The options are those of the driver of the same name; only what concerns the wire is
read here and in the modules of the families.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

from recordings.rig import CanPort, Device, Rig, SerialPort, TcpPort
from sim_devices.can_bus import CanBus, CanNode
from sim_devices.canopen import Encoder, JointDrive
from sim_devices.crystal import crystal_of
from sim_devices.errors import DeviceNotSimulated
from sim_devices.foreign_controller import ForeignController, canopen_words
from sim_devices.line import SerialDevice, SerialLine
from sim_devices.modbus_kinds import modbus_adc, modbus_tcp_adc
from sim_devices.options import channels_of, option, sensed
from sim_devices.plant_seam import Plant
from sim_devices.stream_kinds import ascii_adc, cobs_adc

Make = Callable[[Rig, Device, Plant], Any]


def canopen_encoder(rig: Rig, device: Device, plant: Plant) -> Encoder:
    """A CiA 406 encoder. Options: ``node_id`` 1..127."""
    channels = channels_of(rig, device)
    if len(channels) != 1:
        raise DeviceNotSimulated(
            f"the encoder '{device.name}' delivers {len(channels)} channels of the rig, "
            f'expected one channel with device = "{device.name}"'
        )
    node_id = option(device, "node_id", 1, 127)
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
    node_id = option(device, "node_id", 1, 127)
    return JointDrive(node_id, device.name, device.joint, channel, plant)


def canopen_listener(rig: Rig, device: Device, plant: Plant) -> ForeignController:
    """A CiA 402 drive and the other controller that commands it. Options: ``node_id`` 1..127."""
    drive = canopen_joint(rig, device, plant)
    node_id = option(device, "node_id", 1, 127)
    return ForeignController(drive, sensed(rig, device), plant, canopen_words(node_id))


def _of_dbc(kind: str) -> Callable[[Rig, Device, Plant], CanNode]:
    """A kind of `sim_devices.dbc_kinds`, whose library takes long to import: when it is needed."""

    def make(rig: Rig, device: Device, plant: Plant) -> CanNode:
        node: CanNode = getattr(import_module("sim_devices.dbc_kinds"), kind)(rig, device, plant)
        return node

    return make


CAN_KINDS: dict[str, Callable[[Rig, Device, Plant], CanNode]] = {
    "canopen-encoder": canopen_encoder,
    "canopen-joint": canopen_joint,
    "canopen-listener": canopen_listener,
    "dbc-encoder": _of_dbc("dbc_encoder"),
    "dbc-joint": _of_dbc("dbc_joint"),
    "dbc-listener": _of_dbc("dbc_listener"),
}
SERIAL_KINDS: dict[str, Callable[[Rig, Device, Plant], SerialDevice]] = {
    "ascii-adc": ascii_adc,
    "cobs-adc": cobs_adc,
    "modbus-adc": modbus_adc,
}
TCP_KINDS: dict[str, Callable[[Rig, Device, Plant], SerialDevice]] = {
    "modbus-adc": modbus_tcp_adc,
}


Place = Callable[[Device, Callable[[Device], Any]], Any]
"""Puts at the place of a device what the function makes of it."""


def directly(device: Device, make: Callable[[Device], Any]) -> Any:
    """The device itself, with nothing around it."""
    return make(device)


def can_bus(rig: Rig, port: CanPort, plant: Plant, place: Place = directly) -> CanBus:
    """The virtual nodes on a CAN port; raises DeviceNotSimulated."""
    return CanBus(_build(rig, port.name, plant, CAN_KINDS, "node_id", place))


def serial_line(
    rig: Rig, port: SerialPort | TcpPort, plant: Plant, place: Place = directly
) -> SerialLine:
    """The virtual devices on a serial port or a connection; raises DeviceNotSimulated."""
    kinds = TCP_KINDS if isinstance(port, TcpPort) else SERIAL_KINDS
    return SerialLine(_build(rig, port.name, plant, kinds, "unit_id", place))


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
        if number is not None and number in owners:
            raise DeviceNotSimulated(
                f"'{owners[number]}' and '{device.name}' on port '{port}' both have "
                f"{address} = {number}; addresses on one port must differ"
            )
        owners[number] = device.name
    return built


def _built(rig: Rig, plant: Plant, make: Make, device: Device) -> Any:
    return make(rig, device, plant)
