"""What virtual devices read of a rig: options of a device, its channels, what senses its joint."""

from __future__ import annotations

from recordings.rig import Channel, Device, Rig
from sim_devices.errors import DeviceNotSimulated


def channels_of(rig: Rig, device: Device) -> list[Channel]:
    """The channels that a device delivers, in file order."""
    return [channel for channel in rig.channels if channel.device == device.name]


def sensed(rig: Rig, device: Device) -> str:
    """The channel that senses the joint of a drive; raises DeviceNotSimulated."""
    channel = None if device.joint is None else rig.sensed_by(device.joint)
    if channel is None:
        raise DeviceNotSimulated(
            f"the drive '{device.name}' needs a 'joint' that a channel senses; it has {device.joint!r}"
        )
    return channel.name


def option(device: Device, key: str, low: int, high: int, default: int | None = None) -> int:
    """An integer option; raises DeviceNotSimulated where it is none, or missing without a default."""
    value = device.options.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        found = "missing" if value is None else repr(value)
        raise DeviceNotSimulated(
            f"option '{key}' of device '{device.name}' is {found}, expected {low} to {high}"
        )
    return value


def number(device: Device, key: str, default: float) -> float:
    """A number above 0; raises DeviceNotSimulated where it is none."""
    value = device.options.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise DeviceNotSimulated(
            f"option '{key}' of device '{device.name}' is {value!r}, expected a number above 0"
        )
    return float(value)


def text(device: Device, key: str, default: str | None = None) -> str:
    """A text; raises DeviceNotSimulated where it is none, or missing without a default."""
    value = device.options.get(key, default)
    if not isinstance(value, str):
        raise DeviceNotSimulated(
            f"option '{key}' of device '{device.name}' is {value!r}, expected a text"
        )
    return value
