"""``nonlinearity``: a channel departs smoothly from a straight line, as RVDTs and LVDTs do.

The departure is a table of points over the channel's full scale with a cubic spline through
them, like the calibration sheet of a transducer. Size: ``2%`` is the greatest departure from
the best straight line over full scale, in percent of full scale; a plain number [deg or m]
is the RMS departure from the best straight line over the travel that the plan uses. Truth
tells the latter in both cases.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.size import parse_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.quaternion import Array

_POINTS = 9
_DENSE = 400


class Nonlinearity(Effect):
    """A bent characteristic.

    Args:
        where: channel.
        size: RMS about the best straight line over the travel used [``unit``].
        unit: "deg" or "m".
        at: (k,) points over full scale [rad or m].
        departure: (k,) seen minus true value there [rad or m].
    """

    name = "nonlinearity"

    def __init__(self, where: str, size: float, unit: str, at: Array, departure: Array) -> None:
        from scipy.interpolate import CubicSpline  # slow to import, and most runs hide nothing

        super().__init__(where, size, unit)
        self._low, self._high = at[0], at[-1]
        self._spline = CubicSpline(at, departure, bc_type="natural")

    @classmethod
    def places(cls, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.channels if c.count_range is not None)

    @classmethod
    def typical(cls, rig: Rig, where: str, rng: np.random.Generator) -> str:
        return f"{rng.uniform(0.3, 2.0):.3f}%"

    @classmethod
    def make(cls, request: Request) -> Self:
        channel = request.rig.channel(request.where)
        size = parse_size(cls.name, request.size)
        if size.number < 0:
            raise BadEffect(f"the size of '{cls.name}' is '{request.size}', expected above 0")
        if size.percent and size.number > 10:
            raise BadEffect(f"the size of '{cls.name}' is '{request.size}', expected at most 10%")
        angular = request.rig.dimension_of(channel.senses) == "angle"
        unit, to_si = ("deg", np.pi / 180) if angular else ("m", 1.0)
        gain, offset = (request.values[f"{channel.name}.{part}"] for part in ("gain", "offset"))
        ends = np.array(channel.count_range) - channel.zero_count
        low, high = sorted(gain * ends + offset)

        at = np.linspace(low, high, _POINTS)
        # A transducer bends gently: neighbouring points of the sheet depart alike.
        rough = request.rng.standard_normal(_POINTS + 4)
        raw = cls(request.where, 0.0, unit, at, np.convolve(rough, [1, 3, 4, 3, 1], "valid"))
        scale = np.linspace(low, high, _DENSE)
        line = np.polyfit(scale, raw.at_rest(request.where, scale) - scale, 1)
        shape = raw._spline(at) - np.polyval(line, at)
        straightened = cls(request.where, 0.0, unit, at, shape)
        used = request.travel()[channel.name]
        rms = _rms_about_line(used, straightened.at_rest(request.where, used) - used)
        peak = np.abs(straightened.at_rest(request.where, scale) - scale).max()
        factor = (
            size.number / 100 * (high - low) / peak if size.percent else size.number * to_si / rms
        )
        if factor * peak > 0.2 * (high - low):
            raise BadEffect(
                f"the size of '{cls.name}@{request.where}' is '{request.size}' {unit} RMS, which over the "
                f"little travel of this plan takes a departure of more than 20% of full scale"
            )
        return cls(request.where, float(factor * rms / to_si), unit, at, factor * shape)

    def at_rest(self, channel: str, value: Array) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + self._spline(np.clip(value, self._low, self._high)))


def _rms_about_line(at: Array, departure: Array) -> float:
    """RMS of ``departure`` about its best straight line over the points ``at``."""
    centred = at - at.mean()
    rest = departure - departure.mean()
    rest = rest - centred * (centred @ rest) / (centred @ centred)
    return float(np.sqrt(np.mean(rest**2)))
