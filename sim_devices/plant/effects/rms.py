"""How large a shape is over the stops of a plan: beside a constant, beside a line, along a line."""

from __future__ import annotations

import numpy as np

from sim_devices.plant.quaternion import Array


def rms_about_mean(departure: Array) -> float:
    """RMS of ``departure`` (n,) about its mean."""
    return float(np.std(departure))


def rms_about_line(at: Array, departure: Array) -> float:
    """RMS of ``departure`` (n,) about its best straight line over the points ``at`` (n,)."""
    centred = at - at.mean()
    rest = departure - departure.mean()
    rest = rest - centred * (centred @ rest) / (centred @ centred)
    return float(np.sqrt(np.mean(rest**2)))


def slope(at: Array, departure: Array) -> float:
    """Slope of the best straight line through ``departure`` (n,) over ``at`` (n,); 0 where ``at`` is constant."""
    centred = at - at.mean()
    spread = float(centred @ centred)
    return float(centred @ departure) / spread if spread > 0.0 else 0.0
