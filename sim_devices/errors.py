"""The errors of this room: what keeps a virtual bench from starting.

Every message says what was seen, what was expected and what to do. What a peer does wrong on
the wire is no error here: devices count it and answer as their protocol demands.
"""


class SimDevicesError(Exception):
    """Root of what this room raises."""


class DeviceNotSimulated(SimDevicesError):
    """The rig asks for a device, option or port that no virtual device offers."""


class PortTaken(SimDevicesError):
    """The path at which a virtual port should appear belongs to something else."""


class PortUnavailable(SimDevicesError):
    """The operating system or a CAN interface refuses to provide a port."""
