"""The errors of this room: what can go wrong between the program and a device.

Four parties can be at fault, and each has its errors: the rig file (`OptionError`), the
port (`PortNotFound`, `PortBusy`, `PortDenied`), the device (`DeviceSilent`,
`DeviceRefused`, `Malformed`), and the caller (`BadCommand`, `LinkClosed`). `LinkBroken` is
the world's doing: a port that was open went away.
"""

from __future__ import annotations

from pydantic import ValidationError


class DriverError(Exception):
    """Root of what this room raises."""


class OptionError(DriverError):
    """A rig describes a device or port in a way that its driver cannot serve."""


class PortNotFound(DriverError):
    """There is no such port on this machine."""


class PortBusy(DriverError):
    """Another program holds the port."""


class PortDenied(DriverError):
    """The user of this process may not use the port."""


class DeviceSilent(DriverError):
    """A device did not answer in time."""


class DeviceRefused(DriverError):
    """A device answered that it will not do what it was asked."""


class Malformed(DriverError):
    """Bytes that a device sent do not make sense in its protocol."""


class BadCommand(DriverError):
    """A joint drive was told something that does not fit what it is doing."""


class LinkClosed(DriverError):
    """The link was used before `open` or after `close`: our own doing."""


class LinkBroken(DriverError):
    """The port went away while it was open: unplugged, bus off, or the peer hung up."""


class BusOff(LinkBroken):
    """The CAN controller has left the bus after too many errors; it must be started again."""


def option_faults(error: ValidationError) -> str:
    """What is wrong with a table of options: each key, what was found, and what is allowed."""
    return "; ".join(
        str(fault["msg"])
        if fault["type"] == "rig"
        else f"'{'.'.join(map(str, fault['loc']))}' is {fault['input']!r}: {fault['msg']}"
        for fault in error.errors()
    )
