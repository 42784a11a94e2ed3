"""One rig as it really is: mechanism and sensors made of its true parameters and effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from recordings.rig import Rig, SerialMechanism
from sim_devices.plant.chain import chain_geometry
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.effects.registry import described_effects
from sim_devices.plant.loop import Loop
from sim_devices.plant.plate import Plate, plate_geometry
from sim_devices.plant.quaternion import Array
from sim_devices.plant.sensor import Sensor
from sim_devices.plant.tracker import Trackers
from sim_devices.truth import Truth


@dataclass(frozen=True, slots=True)
class Nature:
    """A rig as it really is.

    Attributes:
        rig: as described.
        truth: as it is.
        mechanism: what moves; of a chain with fixtures, as its first one holds it.
        sensors: by channel.
        trackers: what watches its end.
        loops: a chain as each of its fixtures holds it, by name; by None where it has none.
    """

    rig: Rig
    truth: Truth
    mechanism: Loop | Plate
    sensors: Mapping[str, Sensor]
    trackers: Trackers
    loops: Mapping[str | None, Loop] = field(default_factory=dict)

    def by_channel(self, places: Array) -> dict[str, Array]:
        """Columns of ``places`` (n, places of the rig) by the channels that sense them."""
        names = self.rig.places
        return {c.name: places[:, names.index(c.senses)] for c in self.rig.channels}


def nature_of(rig: Rig, truth: Truth, effects: Sequence[Effect] = ()) -> Nature:
    """The rig with ``truth`` for its parameters; at work are the effects that it describes, and ``effects``.

    Raises:
        BadEffect: the rig describes an effect that nature does not know, or that cannot be so.
    """
    values: Mapping[str, float] = truth.parameters
    known = described_effects(rig, values)
    for effect in known:
        values = effect.values(values)
    effects = (*known, *effects)
    mechanism: Loop | Plate
    loops: dict[str | None, Loop] = {}
    if isinstance(rig.mechanism, SerialMechanism):
        for name in rig.mechanism.fixture_names or (None,):
            geometry = chain_geometry(rig.mechanism, values, name)
            loops[name] = Loop(rig.mechanism, geometry, effects)
        mechanism = next(iter(loops.values()))
    else:
        mechanism = Plate(rig.mechanism, plate_geometry(rig.mechanism, values), effects)
    sensors = {c.name: Sensor(c, values, effects) for c in rig.channels}
    trackers = Trackers(rig, values)
    return Nature(
        rig, truth, mechanism, MappingProxyType(sensors), trackers, MappingProxyType(loops)
    )
