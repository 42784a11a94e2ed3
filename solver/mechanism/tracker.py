"""External trackers: markers on the end of a mechanism, measured in a frame of unknown place.

A marker at m on an end at (R, p) in the base frame is at p + R m there; a tracker at c with
axes Q sees it at Q'(p + R m - c). `Tracked` puts these readings beside those of any model:
its loops stay closed, or, of an arm with the closure "open", there are none. Q = exp(r) of the
rotation vector r, so that no direction of view is singular.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Parameter, Rig, parameters
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import EndPose, Linearised, Model
from solver.mechanism.rotation import exponential, left_jacobian
from solver.mechanism.sensing import Sensing

Array = NDArray[np.float64]

_PARTS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Tracked:
    """A model with trackers that watch its end.

    C channels in all, T of them coordinates of markers.

    Attributes:
        inner: the mechanism and its own channels.
        channels: names of all channels, in rig order.
        own: (C - T,) columns of the inner model's channels.
        seen: (T,) columns of the trackers'.
        sensing: the trackers' channels.
        tracker: (T, 6) indices of x, y, z, rx, ry, rz of each channel's tracker.
        marker: (T, 3) indices of its marker's offset.
        axis: (T,) which coordinate it senses.
    """

    inner: Model
    channels: tuple[str, ...]
    own: NDArray[np.intp]
    seen: NDArray[np.intp]
    sensing: Sensing
    tracker: NDArray[np.intp]
    marker: NDArray[np.intp]
    axis: NDArray[np.intp]

    @classmethod
    def of(cls, rig: Rig, inner: Model, table: tuple[Parameter, ...] | None = None) -> Tracked:
        """The trackers of ``rig`` around ``inner``, the model of `without_trackers`."""
        table = parameters(rig) if table is None else table
        index = {parameter.name: i for i, parameter in enumerate(table)}
        placed = {place: tracker for tracker in rig.trackers for place in tracker.places}
        watching = tuple(c for c in rig.channels if c.senses in placed)
        names = tuple(c.name for c in rig.channels)
        ends = [c.senses.rpartition(".") for c in watching]
        return cls(
            inner,
            names,
            np.array([names.index(name) for name in inner.channels], dtype=np.intp),
            np.array([names.index(c.name) for c in watching], dtype=np.intp),
            Sensing.of(rig.model_copy(update={"channels": watching}), table),
            np.array(
                [[index[f"{placed[c.senses].name}.{part}"] for part in _PARTS] for c in watching],
                dtype=np.intp,
            ).reshape(-1, 6),
            np.array(
                [[index[f"{marker}.{axis}"] for axis in "xyz"] for marker, _, _ in ends],
                dtype=np.intp,
            ).reshape(-1, 3),
            np.array(["xyz".index(axis) for _, _, axis in ends], dtype=np.intp),
        )

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of a pose's coordinates."""
        return self.inner.coordinate_names

    def linearise(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> Linearised:
        """Predictions and derivatives at ``coordinates`` (P, U) and ``parameters`` (N,), along (N, n).

        Where parameters are (P, N), the mechanism's geometry differs from pose to pose; trackers stay.
        """
        inside = self.inner.linearise(coordinates, parameters, directions, at)
        end = self.inner.end_pose(coordinates, parameters, directions)
        parameters = parameters if parameters.ndim == 1 else parameters[0]
        vector = parameters[self.tracker[:, 3:]]
        view = exponential(vector)[np.arange(len(self.axis)), :, self.axis]  # (T, 3) sensed axes
        arm = parameters[self.marker] @ np.swapaxes(end.rotation, 1, 2)  # (P, T, 3)
        apart = end.position[:, None] + arm - parameters[self.tracker[:, :3]]
        value = np.einsum("pti,ti->pt", apart, view)
        # The end's motion [dp; domega] moves a marker along a sensed axis by v.dp + (arm x v).domega.
        swing = np.cross(arm, view)
        wrench = np.concatenate([np.broadcast_to(view, swing.shape), swing], axis=2)  # (P, T, 6)
        by_value = wrench @ end.by_parameters
        by_value += np.einsum("pti,tin->ptn", view @ end.rotation, directions[self.marker])
        by_value -= np.einsum("ti,tin->tn", view, directions[self.tracker[:, :3]])
        turned = np.cross(view, apart)[:, :, None] @ left_jacobian(vector)
        by_value += np.einsum("pti,tin->ptn", turned[:, :, 0], directions[self.tracker[:, 3:]])
        counts, slope, by_sensing = self.sensing.counts(value, parameters, directions)
        return Linearised(
            self._merged(inside.readings, counts),
            inside.closure,
            self._merged(
                inside.readings_by_coordinates, (wrench @ end.by_coordinates) * slope[:, None]
            ),
            self._merged(inside.readings_by_parameters, by_sensing + by_value * slope[:, None]),
            inside.closure_by_coordinates,
            inside.closure_by_parameters,
        )

    def _merged(self, own: Array, seen: Array) -> Array:
        """Columns of both kinds of channels, in rig order."""
        out = np.empty((len(own), len(self.channels), *own.shape[2:]))
        out[:, self.own], out[:, self.seen] = own, seen
        return out

    def pseudo_observations(self, parameters: Array, directions: Array) -> tuple[Array, Array]:
        """The inner model's."""
        return self.inner.pseudo_observations(parameters, directions)

    def end_pose(
        self,
        coordinates: Array,
        parameters: Array,
        directions: Array,
        at: Circumstances | None = None,
    ) -> EndPose:
        """The inner model's."""
        return self.inner.end_pose(coordinates, parameters, directions, at)

    def starts(self, readings: Array, parameters: Array) -> Array:
        """The inner model's, from its own channels."""
        return self.inner.starts(readings[:, self.own], parameters)

    def mobility(self, coordinates: Array, parameters: Array) -> int:
        """The inner model's: to be watched takes no freedom away."""
        return self.inner.mobility(coordinates, parameters)


def without_trackers(rig: Rig) -> Rig:
    """``rig`` with the channels of its mechanism only."""
    inside = tuple(c for c in rig.channels if c.senses in rig.mechanism.places)
    return rig.model_copy(update={"channels": inside, "trackers": ()})
