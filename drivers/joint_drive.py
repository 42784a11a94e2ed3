"""What drives of every protocol share: they move a joint, deliver no channel, obey by their mode. Pure."""

from __future__ import annotations

from typing import Any

from drivers.driver import DeviceSpec
from drivers.errors import BadCommand, OptionError
from recordings.events import Mode


def joint_of(spec: DeviceSpec[Any], kind: str, instead: str) -> str:
    """The joint that a drive moves.

    Args:
        spec: the device of the rig.
        kind: what its driver serves, in words.
        instead: what a channel that names it as its device should do.

    Raises:
        OptionError: the rig says no joint, or has a channel that it should deliver.
    """
    if spec.joint is None:
        raise OptionError(f"device '{spec.name}' is a {kind}; say which 'joint' it moves")
    if spec.channels:
        raise OptionError(
            f"channel '{spec.channels[0].name}' names the {kind} '{spec.name}' as its device; "
            f"{instead}"
        )
    return spec.joint


def require_mode(drive: str, mode: Mode, expected: Mode) -> None:
    """Raise BadCommand where ``drive`` is in another mode than the one that a command needs."""
    if mode is not expected:
        raise BadCommand(f"{drive} is in mode {mode.name}, expected {expected.name}; set it first")
