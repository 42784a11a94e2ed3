"""What repeats with the revolution of a sensor: the base of ``eccentricity`` and ``cyclic-error``.

    seen = v + sum over k of [c_k cos(k phi) + s_k sin(k phi)],   phi = v, or 2 pi v / turn of a length

with few harmonics k. Sizes are the RMS about the mean over the plan's stops [deg or m].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.rms import rms_about_mean
from sim_devices.plant.effects.size import channel_unit, number_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.quaternion import Array

_STEEPEST = 0.4
"""A sensor whose error changes by more than this share of its travel could not be servoed to."""

Wave = tuple[float, float, float]
"""Harmonic, cosine and sine coefficient [rad or m]."""


class Periodic(Effect):
    """An error that repeats with the revolution.

    Args:
        where: channel.
        size: RMS about the mean over the plan's stops [``unit``].
        unit: "deg" or "m".
        turning: phi per value [rad per rad or m].
        waves: what is added.
    """

    def __init__(
        self, where: str, size: float, unit: str, turning: float, waves: Sequence[Wave]
    ) -> None:
        super().__init__(where, size, unit)
        self._turning = turning
        self._waves = tuple(waves)

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.channels if _turning(rig, c.name) is not None)

    def at_rest(self, channel: str, value: Array) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + sum_of_waves(self._waves, self._turning * value))


def sum_of_waves(waves: Sequence[Wave], phi: Array) -> Array:
    """(n,) sum of ``waves`` at angles ``phi`` (n,) [rad]."""
    total = np.zeros_like(phi)
    for harmonic, cosine, sine in waves:
        total = total + cosine * np.cos(harmonic * phi) + sine * np.sin(harmonic * phi)
    return total


def turning_of(rig: Rig, channel: str) -> float:
    """Revolution angle per value of a channel that `Periodic.places` offers [rad per rad or m]."""
    turning = _turning(rig, channel)
    if turning is None:
        raise BadEffect(f"the sensor '{channel}' has no revolution; give its channel a 'turn_m'")
    return turning


def _turning(rig: Rig, channel: str) -> float | None:
    described = rig.channel(channel)
    if rig.dimension_of(described.senses) == "angle":
        return 1.0
    return None if described.turn is None else 2 * np.pi / described.turn


def scaled_waves(name: str, request: Request, waves: Sequence[Wave]) -> tuple[float, list[Wave]]:
    """``waves`` made so large that their RMS over the stops is the size asked for, which is told.

    Raises:
        BadEffect: the plan turns the sensor so little that the error would be steeper than sensors are.
    """
    unit, to_si = channel_unit(request.rig, request.where)
    size = number_size(name, request.size, unit, most=20.0)
    turning = turning_of(request.rig, request.where)
    rms = rms_about_mean(sum_of_waves(waves, turning * request.rests().value[request.where]))
    factor = size * to_si / rms if rms > 0.0 else np.inf
    steepest = factor * turning * sum(h * np.hypot(c, s) for h, c, s in waves)
    if steepest > _STEEPEST:
        raise BadEffect(
            f"the size of '{name}@{request.where}' is '{request.size}' {unit} RMS, which over the travel "
            f"of this plan takes an error that changes by {100 * steepest:.3g}% of the travel, expected "
            f"at most {100 * _STEEPEST:g}%; ask for less"
        )
    return size, [(h, factor * c, factor * s) for h, c, s in waves]


def described_size(true: Mapping[str, float], to_si: float) -> float:
    """RMS over a whole revolution, as it is told."""
    return float(np.hypot(true["cos"], true["sin"]) / np.sqrt(2) / to_si)
