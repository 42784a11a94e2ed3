"""Virtual devices of a DBC file, built from a rig. Options are those of the ``dbc-`` drivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cantools.database.can import Message

from recordings.rig import Device, Rig
from sim_devices.can_bus import Frame
from sim_devices.crystal import crystal_of
from sim_devices.dbc import (
    DbcDrive,
    DbcSensor,
    DriveDescription,
    SensorMessage,
    cycle_s,
    messages_of,
    packed,
)
from sim_devices.errors import DeviceNotSimulated
from sim_devices.foreign_controller import ForeignController, Say
from sim_devices.options import channels_of, number, option, sensed, text
from sim_devices.plant_seam import Plant


def dbc_encoder(rig: Rig, device: Device, plant: Plant) -> DbcSensor:
    """A sensor that sends each message that a channel is in."""
    known = _messages(rig, device)
    signals: dict[str, dict[str, str]] = {}
    for channel in channels_of(rig, device):
        message, name = _find(known, str(channel.signal), device)
        signals.setdefault(message.name, {})[name] = channel.name
    counter, clock = text(device, "counter", ""), text(device, "clock", "")
    cycle_ms = option(device, "cycle_ms", 1, 60_000) if "cycle_ms" in device.options else None
    sent = [
        SensorMessage(
            message=known[name],
            signals=sensed_by,
            counter=counter,
            clock=clock,
            tick_s=option(device, "clock_tick_us", 1, 1_000_000, 1) * 1e-6,
            period_s=cycle_s(known[name], cycle_ms),
        )
        for name, sensed_by in signals.items()
    ]
    return DbcSensor(sent, plant, crystal_of(device.name))


def dbc_joint(rig: Rig, device: Device, plant: Plant) -> DbcDrive:
    """A drive that obeys its command message."""
    return DbcDrive(_drive(rig, device), str(device.joint), sensed(rig, device), plant)


def dbc_listener(rig: Rig, device: Device, plant: Plant) -> ForeignController:
    """A drive and the other controller that commands it."""
    description = _drive(rig, device)
    channel = sensed(rig, device)
    drive = DbcDrive(description, str(device.joint), channel, plant)
    return ForeignController(drive, channel, plant, _words(description))


def _drive(rig: Rig, device: Device) -> DriveDescription:
    known = _messages(rig, device)
    command = _message(known, text(device, "command"), device)
    cycle_ms = option(device, "cycle_ms", 1, 60_000) if "cycle_ms" in device.options else None
    modes = dict(device.options.get("modes", {}))
    status = _message(known, text(device, "status"), device)
    return DriveDescription(
        command=command,
        status=status,
        mode=text(device, "mode"),
        reported_mode=text(device, "reported_mode"),
        modes=modes,
        reported_modes=dict(device.options.get("reported_modes", modes)),
        target_position=text(device, "target_position", ""),
        target_torque=text(device, "target_torque", ""),
        actual_position=text(device, "actual_position", ""),
        error=text(device, "error", ""),
        per_count=number(device, "target_per_count", 1.0),
        at_zero=float(device.options.get("target_at_zero", 0.0)),
        command_s=cycle_s(command, cycle_ms),
        status_s=cycle_s(status, None),
    )


def _messages(rig: Rig, device: Device) -> Mapping[str, Message]:
    if device.file is None:
        raise DeviceNotSimulated(f"the device '{device.name}' needs the 'file' of its DBC")
    return messages_of(rig.files[device.file], device.name)


def _message(known: Mapping[str, Message], name: str, device: Device) -> Message:
    if name not in known:
        raise DeviceNotSimulated(
            f"the file of '{device.name}' has no message '{name}'; it has: {', '.join(known)}"
        )
    return known[name]


def _find(known: Mapping[str, Message], reference: str, device: Device) -> tuple[Message, str]:
    owner, _, name = reference.rpartition(".")
    for message in known.values():
        names = [signal.name for signal in message.signals]
        if owner in ("", message.name) and name in names:
            return message, name
    raise DeviceNotSimulated(f"the file of '{device.name}' has no signal '{reference}'")


def _words(description: DriveDescription) -> Say:
    """How another controller says it: the command message."""

    def say(mode: str, target: int) -> Sequence[Frame]:
        values = {description.mode: description.modes.get(mode, description.modes["off"])}
        if mode == "position":
            values[description.target_position] = description.position(target)
        return [packed(description.command, values)]

    return say
