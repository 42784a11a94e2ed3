"""The node ids of one CANopen bus: each device has its own, and the master has one of its own."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen.device import CanopenDevice
from drivers.errors import OptionError


def master_id_of(port: str, devices: Sequence[CanopenDevice]) -> int | None:
    """The node id of the master that all drives on ``port`` agree on, or None where none heeds it.

    Raises:
        OptionError: two devices have one node id, or the drives disagree about the master's.
    """
    names: dict[int, str] = {}
    for device in devices:
        if device.node_id in names:
            raise OptionError(
                f"'{names[device.node_id]}' and '{device.name}' on port '{port}' both have "
                f"node_id = {device.node_id}; node ids must differ"
            )
        names[device.node_id] = device.name
    masters = {device.master_id: device.name for device in devices if device.master_id}
    if len(masters) > 1:
        given = ", ".join(f"{name}: {number}" for number, name in masters.items())
        raise OptionError(f"the drives on port '{port}' disagree about master_id ({given})")
    for number, name in masters.items():
        if number in names:
            raise OptionError(
                f"master_id = {number} of '{name}' is the node_id of '{names[number]}'; "
                f"choose a number that no device has"
            )
    return next(iter(masters), None)
