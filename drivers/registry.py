"""Finds drivers by name, checks what a rig says about its devices, and makes the links.

Nothing here touches hardware: a rig that a driver cannot serve is refused before any port
is opened, with the key, what was found and what is allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, get_args

from pydantic import ValidationError

from drivers.driver import DeviceSpec, Driver
from drivers.errors import OptionError, option_faults
from drivers.link import Clock, Link
from drivers.watch import WatchedLink
from recordings.rig import CanPort, Device, Rig, SerialPort, TcpPort

GROUP = "loopcal.drivers"

Port = CanPort | SerialPort | TcpPort

BUILT_IN: Mapping[str, str] = {
    "ascii-adc": "drivers.stream.ascii_adc",
    "canopen-encoder": "drivers.canopen.encoder",
    "canopen-joint": "drivers.canopen.joint",
    "canopen-listener": "drivers.canopen.listener",
    "cobs-adc": "drivers.stream.cobs_adc",
    "dbc-encoder": "drivers.dbc.encoder",
    "dbc-joint": "drivers.dbc.joint",
    "dbc-listener": "drivers.dbc.listener",
    "modbus-adc": "drivers.modbus.adc",
}
"""Modules, imported when a rig uses them: each brings the libraries of its own protocol."""


def driver_names() -> tuple[str, ...]:
    """Names of all drivers that a rig can use here."""
    return tuple(sorted({*BUILT_IN, *entry_points(group=GROUP).names}))


def find_driver(name: str) -> Driver[Any, Any]:
    """The driver called ``name``; raises OptionError."""
    if name in BUILT_IN:
        return _driver_in(BUILT_IN[name])
    found = list(entry_points(group=GROUP, name=name))
    if not found:
        known = ", ".join(driver_names())
        raise OptionError(f"there is no driver '{name}'; installed drivers: {known}")
    try:
        driver = found[0].load()
    except (ImportError, AttributeError) as error:
        raise OptionError(
            f"the driver '{name}' cannot be loaded from '{found[0].value}': {error}"
        ) from error
    if not isinstance(driver, Driver):
        raise OptionError(
            f"the entry point '{name}' gives {type(driver).__name__} at '{found[0].value}', "
            f"expected a drivers.driver.Driver"
        )
    return driver


def _driver_in(module: str) -> Driver[Any, Any]:
    driver: Driver[Any, Any] = import_module(module).DRIVER
    return driver


def make_links(
    rig: Rig, clock: Clock, overrides: Mapping[str, str] | None = None
) -> tuple[Link, ...]:
    """One link for each port of ``rig`` that has devices, in file order. Opens nothing.

    Args:
        rig: what is connected to what.
        clock: stamps what arrives and paces the sampling.
        overrides: path (or CAN channel, or TCP address) to use instead of the rig's, by port name.

    Raises:
        OptionError: a device, its options or its channels do not fit its driver.
    """
    moved = dict(overrides or {})
    ports = {port.name: port for port in rig.ports}
    for name in moved:
        if name not in ports:
            known = ", ".join(ports) or "(there are none)"
            raise OptionError(f"there is no port '{name}' in the rig; its ports: {known}")
    links = []
    for port in rig.ports:
        devices = [device for device in rig.devices if device.port == port.name]
        if devices:
            links.append(_link(rig, _moved(port, moved.get(port.name)), devices, clock))
    return tuple(links)


def _moved(port: Port, path: str | None) -> Port:
    if path is None:
        return port
    key = {"can": "channel", "serial": "path", "tcp": "address"}[port.kind]
    try:
        return type(port).model_validate({**port.model_dump(), key: path})
    except ValidationError as error:
        raise OptionError(f"port '{port.name}': {option_faults(error)}") from error


def _link(rig: Rig, port: Port, devices: list[Device], clock: Clock) -> Link:
    drivers = [find_driver(device.driver) for device in devices]
    for device, driver in zip(devices, drivers, strict=True):
        if not isinstance(port, driver.ports):
            kinds = (get_args(kind.model_fields["kind"].annotation)[0] for kind in driver.ports)
            raise OptionError(
                f"device '{device.name}' has the driver '{device.driver}', which needs a port "
                f"of kind {' or '.join(map(repr, kinds))}, "
                f"but its port '{port.name}' is of kind '{port.kind}'"
            )
        if driver.link is not drivers[0].link:
            raise OptionError(
                f"the port '{port.name}' has devices with the drivers '{devices[0].driver}' and "
                f"'{device.driver}', which cannot share a port"
            )
    made = [
        driver.make(_spec(rig, device, driver))
        for device, driver in zip(devices, drivers, strict=True)
    ]
    link: Link = drivers[0].link(port, made, clock)
    names = {device.name for device in devices}
    delivered = [channel for channel in rig.channels if channel.device in names]
    return WatchedLink(link, delivered, clock)


def _spec(rig: Rig, device: Device, driver: Driver[Any, Any]) -> DeviceSpec[Any]:
    try:
        options = driver.options.model_validate(device.options)
    except ValidationError as error:
        raise OptionError(
            f"device '{device.name}' ({device.driver}) has wrong options: {option_faults(error)}"
        ) from error
    channels = tuple(channel for channel in rig.channels if channel.device == device.name)
    return DeviceSpec(
        name=device.name,
        driver=device.driver,
        port=device.port,
        joint=device.joint,
        channels=channels,
        options=options,
        file=None if device.file is None else rig.files[device.file],
    )
