"""The loads that compliant effects yield to, for either family of mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from recordings.rig import Rig, SerialMechanism
from sim_devices.plant.chain import ChainGeometry, chain_geometry
from sim_devices.plant.chain_statics import ChainLoads, ChainStatics, has_weights
from sim_devices.plant.effects.effect import Request
from sim_devices.plant.effects.mount import Mount
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.plate import PlateGeometry, plate_geometry
from sim_devices.plant.plate_statics import PlateLoads, PlateStatics, has_weight
from sim_devices.plant.quaternion import Array


@dataclass(frozen=True, slots=True)
class Loads:
    """Statics of a rig: one of the two, by its family."""

    chain: ChainStatics | None = None
    plate: PlateStatics | None = None

    @staticmethod
    def known(rig: Rig) -> bool:
        """Whether the rig states masses and gravity, and something holds them."""
        return has_weights(rig) or has_weight(rig)

    def of_chain(self, geometry: ChainGeometry, coordinates: Array) -> ChainLoads:
        """At joint variables (n, J)."""
        if self.chain is None:
            raise BadEffect("loads of a chain were asked of a platform")
        return self.chain.loads(geometry, coordinates)

    def of_plate(self, geometry: PlateGeometry, coordinates: Array) -> PlateLoads:
        """At plate turns and shifts (n, 7)."""
        if self.plate is None:
            raise BadEffect("loads of a platform were asked of a chain")
        return self.plate.loads(geometry, coordinates[:, :4], coordinates[:, 4:])


@dataclass(frozen=True, slots=True)
class LoadsAtRest:
    """Loads at the stops of the plan.

    Attributes:
        carried: (n, places) by drives or legs [Nm or N].
        force: (n, 3) on the mount of a chain, in its frame, or on a pivot, in the base frame [N].
    """

    carried: Array
    force: Array


def loads_of(rig: Rig, values: Mapping[str, float]) -> Loads:
    """Statics of a rig with the parameters ``values``, SI, by name."""
    gravity = np.array(rig.gravity or (0.0, 0.0, 0.0))
    if isinstance(rig.mechanism, SerialMechanism):
        drives = rig.plan.drives if rig.plan is not None else ()
        return Loads(chain=ChainStatics(rig.mechanism, values, gravity, drives))
    return Loads(plate=PlateStatics(rig.mechanism, gravity))


def loads_at_rest(request: Request) -> LoadsAtRest:
    """Loads at the stops of the plan; of several fixtures, as the first one holds the chain."""
    rig, coordinates = request.rig, request.rests().coordinates
    loads = loads_of(rig, request.values)
    if isinstance(rig.mechanism, SerialMechanism):
        names = rig.mechanism.fixture_names or (None,)
        chain = chain_geometry(rig.mechanism, request.values, names[0])
        of_chain = loads.of_chain(chain, coordinates)
        mount = Mount(rig.mechanism, request.values).frame(chain, coordinates)
        return LoadsAtRest(of_chain.torque, of_chain.seen_from(mount)[0])
    of_plate = loads.of_plate(plate_geometry(rig.mechanism, request.values), coordinates)
    return LoadsAtRest(of_plate.tension, of_plate.force)
