"""A rig as a host must see it when its devices are virtual: the same, with its ports elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from recordings.rig import CanPort, Rig, SerialPort, TcpPort


def moved_rig(rig: Rig, addresses: Mapping[str, str]) -> Rig:
    """``rig`` with its ports at ``addresses``, by port name. CAN ports become slcan adapters."""
    ports = tuple(_moved(port, addresses[port.name]) for port in rig.ports)
    return rig.model_copy(update={"ports": ports})


def _moved(port: CanPort | SerialPort | TcpPort, address: str) -> CanPort | SerialPort | TcpPort:
    if isinstance(port, CanPort):
        moved: dict[str, Any] = {"interface": "slcan", "channel": address}
        # The options of another interface mean nothing to an slcan adapter.
        kept: dict[str, Any] = {} if port.interface == "slcan" else {"options": {}}
        return port.model_copy(update={**moved, **kept})
    if isinstance(port, SerialPort):
        return port.model_copy(update={"path": address})
    return port.model_copy(update={"address": address})
