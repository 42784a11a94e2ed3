"""Counts and readings of the channels that sense the joints a plan drives.

value = gain (counts - zero_count) + offset, with the nominal values of the rig: good enough
to go somewhere near, which is all a plan asks. Refuses to calibrate.
"""

from __future__ import annotations

from dataclasses import dataclass

from daq.errors import PlanNotPossible
from recordings.rig import Rig, parameters


@dataclass(frozen=True, slots=True)
class Scale:
    """Nominal meaning of one channel's counts.

    Attributes:
        channel: name of the channel.
        gain: rad or m per count.
        offset: reading at ``zero_count`` [rad or m].
        zero_count: count at which the reading is ``offset``.
        lowest: lowest count the channel can show, or None where the rig says nothing.
        highest: highest count the channel can show, or None.
        modulus: counts after which the channel repeats, or None.
    """

    channel: str
    gain: float
    offset: float
    zero_count: int
    lowest: int | None
    highest: int | None
    modulus: int | None

    def value(self, counts: float) -> float:
        """Reading [rad or m] of ``counts``, nearest the zero count where the channel wraps."""
        away = counts - self.zero_count
        if self.modulus is not None:
            away = (away + self.modulus / 2) % self.modulus - self.modulus / 2
        return self.gain * away + self.offset

    def away(self, value: float, target: float) -> float:
        """How far ``value`` lies from ``target`` [rad or m], the short way where the channel wraps."""
        away = value - target
        if self.modulus is None:
            return away
        turn = abs(self.gain) * self.modulus
        return (away + turn / 2) % turn - turn / 2

    def counts(self, value: float) -> int:
        """Counts at the reading ``value`` [rad or m].

        Raises:
            PlanNotPossible: the channel cannot show that reading.
        """
        counts = self.zero_count + round((value - self.offset) / self.gain)
        if self.modulus is not None:
            bottom = self.zero_count - self.modulus // 2 if self.lowest is None else self.lowest
            counts = (counts - bottom) % self.modulus + bottom
        low, high = self.lowest, self.highest
        if (low is not None and counts < low) or (high is not None and counts > high):
            raise PlanNotPossible(
                f"channel '{self.channel}' would read {counts} counts at {value:.6g} (rad or m), outside its "
                f"count_range [{low}, {high}]; correct the plan's targets or corners"
            )
        return counts


def scale_of(rig: Rig, joint: str) -> Scale:
    """Scale of the channel that senses ``joint``; raises PlanNotPossible where none does."""
    channel = rig.sensed_by(joint)
    if channel is None:
        raise PlanNotPossible(f"no channel senses '{joint}', so a plan cannot drive it")
    nominal = {parameter.name: parameter.nominal for parameter in parameters(rig)}
    low, high = channel.count_range or (None, None)
    return Scale(
        channel.name,
        nominal[f"{channel.name}.gain"],
        nominal[f"{channel.name}.offset"],
        channel.zero_count,
        low,
        high,
        channel.modulus_counts,
    )
