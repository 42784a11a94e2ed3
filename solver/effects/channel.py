"""What effects at one channel have in common: where they can sit, and how their shift is put.

Owns the bookkeeping only; every law of physics is in an effect's own file.
"""

from __future__ import annotations

import numpy as np

from solver.effects.effect import Array, Effect, Shift, Site


class ChannelEffect(Effect):
    """An effect at one channel that senses the mechanism itself.

    Attributes:
        channel: index of the channel.
        measures: "angle" or "length".
    """

    def __init__(self, site: Site, where: str) -> None:
        super().__init__(site, where)
        self.channel = site.channel(where)
        self.measures = site.dimension(where)

    @classmethod
    def places(cls, site: Site) -> tuple[str, ...]:
        inside = site.rig.mechanism.places
        return tuple(c.name for c in site.rig.channels if c.senses in inside)

    def of_size(self, angle: float, length: float) -> float:
        """The one of two plausible sizes [rad, m] that fits what the channel measures."""
        return angle if self.measures == "angle" else length

    def shift(
        self, shapes: Array, coefficients: Array, slope: Array | None = None, values: int = 0
    ) -> Shift:
        """A shift linear in the coefficients.

        Args:
            shapes: (P, k) what one unit of each coefficient adds [rad or m].
            coefficients: (k,).
            slope: (P,) derivative of the shift with the channel's own true value.
            values: C, number of channels; needed with ``slope``.
        """
        by_values = None
        if slope is not None:
            by_values = np.zeros((len(shapes), 1, values))
            by_values[:, 0, self.channel] = slope
        target = np.array([self.channel], dtype=np.intp)
        return Shift(target, (shapes @ coefficients)[:, None], shapes[:, None, :], by_values)


def rms_about_mean(shift: Shift) -> float:
    """RMS [rad or m] of a shift of one channel, about its mean: a constant is the channel's offset."""
    return float(np.std(shift.amount[:, 0]))
