"""A plate on legs in step with a clock, moved by a scripted hand.

The person begins once somebody looks: `LEAD_S` after a channel is first sensed. After the
last visit of the plan the rounds go on, so that a capture that came late misses nothing.
"""

from __future__ import annotations

import numpy as np

from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.hand import Hand
from sim_devices.plant.motion import Course
from sim_devices.plant.nature import Nature
from sim_devices.plant.plate import Plate
from sim_devices.plant.quaternion import Array
from sim_devices.plant.seeds import NOISE, stream
from sim_devices.plant.session import legs_and_markers
from sim_devices.plant.stop import LEAD_S


class PlatformPlant:
    """Nature of a platform rig in real time; a `sim_devices.plant_seam.Plant`.

    Args:
        nature: the rig as it really is.
        plate: its mechanism.
        hand: what moves it, or None where the rig has no plan: then the plate stays neutral.
    """

    def __init__(self, nature: Nature, plate: Plate, hand: Hand | None) -> None:
        rig = nature.rig
        self._plate, self._hand, self._sensors = plate, hand, nature.sensors
        self._nature = nature
        self._column = {c.name: rig.places.index(c.senses) for c in rig.channels}
        self._rng = {
            c.name: stream(nature.truth.seed, NOISE, k) for k, c in enumerate(rig.channels)
        }
        self._rounds = 0
        self._planned_until_s: float | None = None
        self._time_s = 0.0
        self._places = self._places_at(0.0)
        self._rates = np.zeros_like(self._places)

    def advance(self, time_s: float) -> None:
        """Move nature to ``time_s``; a time that has passed changes nothing."""
        if time_s <= self._time_s:
            return
        places = self._places_at(time_s)
        self._rates = (places - self._places) / (time_s - self._time_s)
        self._places, self._time_s = places, time_s

    def sense(self, channel: str) -> int:
        """Raw counts of ``channel`` now; the first call tells the person to begin."""
        if self._planned_until_s is None:
            self._planned_until_s = self._time_s + LEAD_S
        value = {name: self._places[[column]] for name, column in self._column.items()}
        rate = {name: self._rates[[column]] for name, column in self._column.items()}
        course = Course(np.array([self._time_s]), value, rate)
        return int(self._sensors[channel].counts(course, self._rng[channel])[0])

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        """Raises CannotSimulate: a platform has legs that only sense."""
        raise CannotSimulate(f"'{joint}' was commanded, but a platform has no drives")

    def drive_fault(self, joint: str) -> int:
        """Raises CannotSimulate: a platform has legs that only sense."""
        raise CannotSimulate(f"'{joint}' was asked for faults, but a platform has no drives")

    def _places_at(self, time_s: float) -> Array:
        moment = np.array([time_s])
        if self._hand is None:
            turn, shift = self._plate.neutral_turn[None], self._plate.neutral_shift[None]
        else:
            while self._planned_until_s is not None and time_s >= self._planned_until_s:
                stops = self._hand.round(self._rounds, self._planned_until_s)
                self._planned_until_s = stops[-1].leave_s
                self._rounds += 1
            turn, shift = self._hand.plate_at(moment)
        return np.asarray(legs_and_markers(self._nature, self._plate, turn, shift, moment)[0])
