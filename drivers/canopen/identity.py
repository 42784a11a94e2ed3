"""Who a CANopen node is: device type 0x1000, name 0x1008, identity 0x1018 (CiA 301)."""

from __future__ import annotations

from drivers.canopen.sdo import Sdo
from drivers.errors import DeviceRefused
from drivers.identity import VIRTUAL_PREFIX, Identity


def identify(sdo: Sdo, profile: int, kind: str) -> Identity:
    """Ask a node who it is.

    Args:
        sdo: its object dictionary.
        profile: device profile that the driver speaks (406, 402), the lower half of 0x1000.
        kind: what the driver serves, in words.

    Raises:
        DeviceSilent: no answer.
        DeviceRefused: it does not give its device type, which every node must.
    """
    device_type = sdo.read_integer(0x1000)
    text = _name(sdo)
    found = device_type & 0xFFFF
    problem = ""
    if found != profile:
        problem = (
            f"it follows the device profile CiA {found}, expected CiA {profile} ({kind}); "
            f"check its node_id in the rig"
        )
    return Identity(text, text.startswith(VIRTUAL_PREFIX), problem)


def _name(sdo: Sdo) -> str:
    try:
        return sdo.read_text(0x1008)
    except DeviceRefused:
        # The name is optional; vendor and product are not.
        vendor, product = sdo.read_integer(0x1018, 1), sdo.read_integer(0x1018, 2)
        return f"vendor 0x{vendor:08X}, product 0x{product:08X}"
