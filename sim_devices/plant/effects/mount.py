"""What holds the end of a chain, and what becomes of the loop when that is displaced.

In a rig with fixtures the chain ends in F M instead of F, where M is the displacement in the
fixture's own frame. In a rig without, the stand with all that lies before the base frame (a
hinge) is displaced by M in the base frame: with H from the start of the chain to its base, the
loop H M^-1 (rest) = I is the loop (H M H^-1)^-1 H (rest) = I.

Owns where M is told; how large it is, effects say.
"""

from __future__ import annotations

from collections.abc import Mapping

from recordings.rig import SerialMechanism
from sim_devices.plant.chain import Chain, ChainGeometry, Fixed, displaced, transforms_ahead
from sim_devices.plant.quaternion import Array


class Mount:
    """The fixture, or the stand, of a chain.

    Args:
        mechanism: of the rig.
        values: parameters, SI, by name.
    """

    def __init__(self, mechanism: SerialMechanism, values: Mapping[str, float]) -> None:
        self._chain: Chain | None = None
        if mechanism.base is not None and not mechanism.fixtures:
            self._chain = Chain(mechanism)
            self._base = mechanism.places.index(mechanism.base) + 1
            self._back = transforms_ahead(mechanism, values)[self._base].back

    def frame(self, geometry: ChainGeometry, variables: Array) -> Fixed | None:
        """H at joint variables (n, J), or None where M is told in the frame where the chain ends."""
        if self._chain is None:
            return None
        turns, _, origins = self._chain.reach(geometry, variables)
        return Fixed(turns[:, self._base], origins[:, self._base]).then(self._back)

    def displaced(self, geometry: ChainGeometry, variables: Array, moved: Fixed) -> ChainGeometry:
        """``geometry`` with the mount displaced by ``moved`` (n, ...), in its frame."""
        frame = self.frame(geometry, variables)
        if frame is not None:
            moved = frame.then(moved).then(frame.back)
        return displaced(geometry, moved.turn, moved.shift)
