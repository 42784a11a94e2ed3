"""The errors of this room: input that cannot lead to a result.

Not converging, or not being identifiable, is a status of a result and never an exception.
"""


class SolverError(Exception):
    """Root of what this room raises."""


class NotEnoughData(SolverError):
    """The recording has no usable dwells, or fewer poses than the parameters need."""


class MethodError(SolverError):
    """The method asked for does not exist, or does not fit the mechanism."""


class MechanismError(SolverError):
    """The mechanism cannot be assembled, or is not of a kind that the solver knows."""
