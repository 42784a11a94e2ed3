"""Drivers: what speaks to encoders, joint drives and ADCs over CAN buses and serial lines.

One module a device family, each speaking one wire protocol; its docstring is the wire
contract. Bytes and frames become readings and reports, commands become frames. Owns the
time stamps (arrival, by an injected clock), the pacing of samples, and the count of what
was lost. Refuses to know what a count means, and what a session is.

    links = make_links(rig, clock)
    for link in links:
        link.open()
        print(link.check())
"""

from drivers.errors import (
    BadCommand,
    DeviceRefused,
    DeviceSilent,
    DriverError,
    LinkBroken,
    LinkClosed,
    Malformed,
    OptionError,
    PortBusy,
    PortDenied,
    PortNotFound,
)
from drivers.link import Clock, DeviceStatus, JointDrive, Link, Losses
from drivers.registry import driver_names, make_links
from recordings.faults import FaultKind

__all__ = [
    "BadCommand",
    "Clock",
    "DeviceRefused",
    "DeviceSilent",
    "DeviceStatus",
    "DriverError",
    "FaultKind",
    "JointDrive",
    "Link",
    "LinkBroken",
    "LinkClosed",
    "Losses",
    "Malformed",
    "OptionError",
    "PortBusy",
    "PortDenied",
    "PortNotFound",
    "driver_names",
    "make_links",
]
