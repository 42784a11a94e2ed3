"""Sensors: the straight line between a true coordinate and its counts.

counts = zero_count + (value - offset) / gain. Shared by both families; effects beyond the
straight line are not this file's business.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Channel, Parameter, Rig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensing:
    """The channels of a rig as arrays, in rig order.

    Attributes:
        channels: the rig's channels.
        offset: (C,) indices of their offsets in the parameter vector.
        gain: (C,) indices of their gains.
        zero: (C,) [counts].
    """

    channels: tuple[Channel, ...]
    offset: NDArray[np.intp]
    gain: NDArray[np.intp]
    zero: Array

    @classmethod
    def of(cls, rig: Rig, table: Sequence[Parameter]) -> Sensing:
        """Sensing of ``rig``, whose parameter table is ``table``."""
        index = {parameter.name: i for i, parameter in enumerate(table)}
        return cls(
            rig.channels,
            np.array([index[f"{channel.name}.offset"] for channel in rig.channels], dtype=np.intp),
            np.array([index[f"{channel.name}.gain"] for channel in rig.channels], dtype=np.intp),
            np.array([float(channel.zero_count) for channel in rig.channels]),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        return tuple(channel.name for channel in self.channels)

    def values(self, counts: Array, parameters: Array) -> Array:
        """(P, C) true coordinates [rad or m] that would give ``counts`` (P, C)."""
        return parameters[..., self.gain] * (counts - self.zero) + parameters[..., self.offset]

    def by_parameters(self, counts: Array, directions: Array) -> Array:
        """(P, C, n) derivative of `values` along ``directions`` (N, n), at fixed counts (P, C)."""
        return directions[self.offset] + (counts - self.zero)[:, :, None] * directions[self.gain]

    def counts(
        self, values: Array, parameters: Array, directions: Array
    ) -> tuple[Array, Array, Array]:
        """Counts of true coordinates, and their derivatives.

        Args:
            values: (P, C) [rad or m].
            parameters: (N,) or (P, N).
            directions: (N, n).

        Returns:
            (P, C) counts, (C,) or (P, C) d counts / d value, (P, C, n) d counts / d directions.
        """
        gain = parameters[..., self.gain]
        scaled = (values - parameters[..., self.offset]) / gain
        slope = 1.0 / gain
        by_parameters = (
            -(directions[self.offset] + scaled[:, :, None] * directions[self.gain])
            * slope[..., None]
        )
        return self.zero + scaled, slope, by_parameters
