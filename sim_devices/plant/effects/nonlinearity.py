"""``nonlinearity``: a channel departs smoothly from a straight line, as RVDTs and LVDTs do.

Hidden, the departure is a table of points over the channel's full scale with a cubic spline
through them, like the calibration sheet of a transducer. Size: ``2%`` is the greatest departure
from the best straight line over full scale, in percent of full scale; a plain number [deg or
m] is the RMS departure from the best straight line over the travel that the plan uses. Truth
tells the latter in both cases.

Described, it is a sum of Legendre polynomials from P1 on, by Bonnet's recurrence
(n + 1) P_n+1 = (2 n + 1) x P_n - n P_n-1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Self

import numpy as np

from recordings.rig import DescribedEffect, Rig
from sim_devices.plant.effects.described import (
    channel_dimension,
    channel_names,
    check_place,
    read_values,
)
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.rms import rms_about_line
from sim_devices.plant.effects.size import channel_unit, parse_size
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.quaternion import Array

_POINTS = 9
_DENSE = 400
_DEGREES = range(1, 41)

Departure = Callable[[Array], Array]
"""Seen minus true value, at true values (n,) [rad or m]."""


class Nonlinearity(Effect):
    """A bent characteristic.

    Args:
        where: channel.
        size: RMS about the best straight line over the travel used [``unit``].
        unit: "deg" or "m".
        departure: what is seen beyond the true value.
    """

    name = "nonlinearity"

    def __init__(self, where: str, size: float, unit: str, departure: Departure) -> None:
        super().__init__(where, size, unit)
        self._departure = departure

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
        unit, to_si = channel_unit(request.rig, request.where)
        gain, offset = (request.values[f"{channel.name}.{part}"] for part in ("gain", "offset"))
        # places() offers only channels with a count range.
        ends = np.array(channel.count_range or (0, 1)) - channel.zero_count
        low, high = sorted(gain * ends + offset)

        at = np.linspace(low, high, _POINTS)
        # A transducer bends gently: neighbouring points of the sheet depart alike.
        rough = request.rng.standard_normal(_POINTS + 4)
        sheet = np.convolve(rough, [1, 3, 4, 3, 1], "valid")
        scale = np.linspace(low, high, _DENSE)
        sheet = sheet - np.polyval(np.polyfit(scale, _spline(at, sheet)(scale), 1), at)
        straightened = _spline(at, sheet)
        used = request.rests().value[channel.name]
        rms = rms_about_line(used, straightened(used))
        peak = np.abs(straightened(scale)).max()
        factor = (
            size.number / 100 * (high - low) / peak if size.percent else size.number * to_si / rms
        )
        if factor * peak > 0.2 * (high - low):
            raise BadEffect(
                f"the size of '{cls.name}@{request.where}' is '{request.size}' {unit} RMS, which over the "
                f"little travel of this plan takes a departure of more than 20% of full scale"
            )
        told = float(factor * rms / to_si)
        return cls(request.where, told, unit, _spline(at, factor * sheet))

    @classmethod
    def described(cls, effect: DescribedEffect, rig: Rig, values: Mapping[str, float]) -> Self:
        check_place(effect, channel_names(rig))
        dimension = channel_dimension(rig, effect.where)
        parts = {f"p{n}": dimension for n in _DEGREES}
        last = max((n for n in _DEGREES if f"p{n}" in effect.values), default=1)
        true = read_values(effect, values, parts, {"low": dimension, "high": dimension})
        if not true["low"] < true["high"]:
            raise BadEffect(f"the effect '{effect.label}' of the rig has 'high' not above 'low'")
        unit, to_si = channel_unit(rig, effect.where)
        bent = _legendre([true[f"p{n}"] for n in range(1, last + 1)], true["low"], true["high"])
        scale = np.linspace(true["low"], true["high"], _DENSE)
        return cls(effect.where, rms_about_line(scale, bent(scale)) / to_si, unit, bent)

    def at_rest(self, channel: str, value: Array) -> Array:
        if channel != self.where:
            return value
        return np.asarray(value + self._departure(value))


def _spline(at: Array, departure: Array) -> Departure:
    """The sheet ``departure`` at points ``at``, kept at its ends beyond them."""
    from scipy.interpolate import CubicSpline  # slow to import, and most runs hide nothing

    through = CubicSpline(at, departure, bc_type="natural")
    return lambda value: np.asarray(through(np.clip(value, at[0], at[-1])))


def _legendre(coefficients: list[float], low: float, high: float) -> Departure:
    def bent(value: Array) -> Array:
        x = (2 * value - low - high) / (high - low)
        before, now, total = np.ones_like(x), x, np.zeros_like(x)
        for n, coefficient in enumerate(coefficients, start=1):
            total = total + coefficient * now
            before, now = now, ((2 * n + 1) * x * now - n * before) / (n + 1)
        return np.asarray(total)

    return bent
