"""The plant of a rig in step with a clock, for the virtual devices."""

from __future__ import annotations

from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.loop import Loop
from sim_devices.plant.nature import Nature
from sim_devices.plant.platform import PlatformPlant
from sim_devices.plant.serial import SerialPlant
from sim_devices.plant.session import scripted_hand


def make_plant(nature: Nature) -> SerialPlant | PlatformPlant:
    """Nature as the virtual devices meet it (`sim_devices.plant_seam.Plant`).

    Raises:
        MechanismDoesNotClose: there is no configuration to start from.
        CannotSimulate: the plan of a platform is not by hand; or a rig with several fixtures.
    """
    if len(nature.loops) > 1:
        raise CannotSimulate(
            f"the rig '{nature.rig.name}' has {len(nature.loops)} fixtures, and at a live bench nobody carries "
            "the endpoint from one to the next; run a rig with one of them, or 'loopcal simulate' for all"
        )
    if isinstance(nature.mechanism, Loop):
        return SerialPlant(nature, nature.mechanism)
    hand = scripted_hand(nature, nature.mechanism) if nature.rig.plan else None
    return PlatformPlant(nature, nature.mechanism, hand)
