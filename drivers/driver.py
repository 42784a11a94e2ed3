"""What a driver provides: the options it takes, and how to make its devices and their link.

A driver is a module with a `Driver` object. It is found by name: the built-in ones by
`drivers.registry`, others by an entry point of the group ``loopcal.drivers``::

    [project.entry-points."loopcal.drivers"]
    my-adc = "my_package.my_adc:DRIVER"

Devices that share a port share one link, so their drivers name the same ``link``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from drivers.link import Clock, Link
from recordings.rig import CanPort, Channel, SerialPort, TcpPort
from recordings.rig.quantity import Described

Options = TypeVar("Options", bound=Described)
Options_co = TypeVar("Options_co", bound=Described, covariant=True)
Device = TypeVar("Device")


@dataclass(frozen=True, slots=True)
class DeviceSpec(Generic[Options_co]):
    """One device of a rig, as its driver gets it.

    Attributes:
        name: device name of the rig.
        driver: name of the driver.
        port: name of its port.
        joint: joint that it moves, or None.
        channels: channels of the rig that it delivers, in file order.
        options: its options, valid.
        file: text of the file that describes it, None where the rig names none.
    """

    name: str
    driver: str
    port: str
    joint: str | None
    channels: tuple[Channel, ...]
    options: Options_co
    file: str | None = None


@dataclass(frozen=True, slots=True)
class Driver(Generic[Options, Device]):
    """A driver.

    Attributes:
        options: model of the options table of its devices.
        ports: kinds of port that its devices can be on.
        make: makes a device; raises OptionError where the rig and the driver do not agree.
        link: makes the link of a port from all devices on it; raises OptionError likewise.
    """

    options: type[Options]
    ports: tuple[type[CanPort | SerialPort | TcpPort], ...]
    make: Callable[[DeviceSpec[Options]], Device]
    link: Callable[[Any, Sequence[Device], Clock], Link]
