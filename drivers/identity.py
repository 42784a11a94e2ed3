"""Who a device says that it is, and what a session is told of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from drivers.errors import DriverError
from drivers.link import DeviceStatus

VIRTUAL_PREFIX = "loopcal virtual"
"""How the name of a simulated device begins."""


@dataclass(frozen=True, slots=True)
class Identity:
    """What a device says that it is; ``problem`` is "" when that is what the rig expects."""

    text: str
    virtual: bool
    problem: str = ""


class Named(Protocol):
    """A device of the rig, with the name of its driver and the channels that it delivers."""

    name: str
    driver: str

    @property
    def channels(self) -> Iterable[str]: ...


def status_of(device: Named, port: str, identify: Callable[[], Identity]) -> DeviceStatus:
    """What came of asking ``device`` on ``port`` who it is; an error of the driver is an answer too."""
    channels = tuple(device.channels)
    try:
        identity = identify()
    except DriverError as error:
        return DeviceStatus(
            device.name, device.driver, port, channels, answers=False, problem=str(error)
        )
    return DeviceStatus(
        name=device.name,
        driver=device.driver,
        port=port,
        channels=channels,
        answers=True,
        identity=identity.text,
        virtual=identity.virtual,
        problem=identity.problem,
    )
