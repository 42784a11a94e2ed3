"""The errors of nature: what keeps a mechanism from existing, moving or being simulated.

Every message says what was seen, what was expected and what to do.
"""

from sim_devices.errors import SimDevicesError


class MechanismDoesNotClose(SimDevicesError):
    """No configuration closes the loop of the mechanism as it really is."""


class CannotSimulate(SimDevicesError):
    """The rig lacks what a simulation needs, or asks for a motion that physics refuses."""


class BadEffect(SimDevicesError):
    """A hidden effect is not spelled ``NAME@WHERE=SIZE``, or has no such name, place or size."""


class TruthNotWritten(SimDevicesError):
    """The truth file exists already, or cannot be written."""
