"""Motion of a mechanism over time: courses of what is sensed, and profiles of what is driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_devices.plant.quaternion import Array

RAMP_S = 0.1
"""Time in which a drive reaches its full speed [s]."""


@dataclass(frozen=True, slots=True)
class Course:
    """What the sensed places do over n moments in order of time.

    Attributes:
        time_s: (n,) since the session began.
        value: by channel, (n,) joint variable or leg length [rad or m] as it really is.
        rate: by channel, (n,) its rate [rad/s or m/s].
    """

    time_s: Array
    value: Mapping[str, Array]
    rate: Mapping[str, Array]


def sampled_course(time_s: Array, value: Mapping[str, Array]) -> Course:
    """A course of n >= 2 samples, with rates by central differences."""
    return Course(time_s, value, {name: np.gradient(v, time_s) for name, v in value.items()})


@dataclass(frozen=True, slots=True)
class Profile:
    """A trapezoid of speed: accelerate, cruise, brake, and stand exactly at the target.

    Attributes:
        start_s: when it begins.
        start, target: position at its ends [rad or m].
        start_speed: speed as it begins.
        peak_speed: speed of the cruise, signed.
        acceleration: of the first phase, signed.
        phases_s: durations of the three phases.
    """

    start_s: float
    start: float
    target: float
    start_speed: float = 0.0
    peak_speed: float = 0.0
    acceleration: float = 0.0
    phases_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def end_s(self) -> float:
        """When it stands at its target."""
        return self.start_s + sum(self.phases_s)

    def at(self, time_s: Array) -> Array:
        """Position at each of ``time_s`` (n,)."""
        since = np.maximum(time_s - self.start_s, 0.0)
        up, cruise, down = self.phases_s
        t1 = np.minimum(since, up)
        t2 = np.clip(since - up, 0.0, cruise)
        t3 = np.clip(since - up - cruise, 0.0, down)
        moved = (
            self.start
            + self.start_speed * t1
            + self.acceleration * t1**2 / 2
            + self.peak_speed * (t2 + t3)
            - np.sign(self.peak_speed) * abs(self.acceleration) * t3**2 / 2
        )
        return np.where(time_s >= self.end_s, self.target, moved)

    def speed_at(self, time_s: float) -> float:
        """Speed at one moment."""
        since = max(time_s - self.start_s, 0.0)
        up, cruise, down = self.phases_s
        if since < up:
            return self.start_speed + self.acceleration * since
        if since < up + cruise:
            return self.peak_speed
        if since < up + cruise + down:
            left = up + cruise + down - since
            return float(np.sign(self.peak_speed)) * abs(self.acceleration) * left
        return 0.0


def move(
    start_s: float, start: float, target: float, speed: float, start_speed: float = 0.0
) -> Profile:
    """The quickest trapezoid to ``target`` that stays below ``speed`` > 0 and ramps in `RAMP_S`."""
    a = speed / RAMP_S
    braking_ends = start + start_speed * abs(start_speed) / (2 * a)
    way = float(np.sign(target - braking_ends))
    if way == 0.0:
        # Already braking to the target, or standing there.
        way = float(np.sign(start_speed))
        return Profile(
            start_s,
            start,
            target,
            start_speed,
            start_speed,
            way * a,
            (0.0, 0.0, abs(start_speed) / a),
        )
    distance, forward = way * (target - start), way * start_speed
    peak = min(speed, float(np.sqrt(a * distance + forward**2 / 2)))
    cruise = (distance - (2 * peak**2 - forward**2) / (2 * a)) / peak
    phases = ((peak - forward) / a, max(cruise, 0.0), peak / a)
    return Profile(start_s, start, target, start_speed, way * peak, way * a, phases)


def minimum_jerk(fraction: Array) -> Array:
    """Share of the way of a hand's move at a share of its time, both in [0, 1]."""
    t = np.clip(fraction, 0.0, 1.0)
    return np.asarray(t**3 * (10 + t * (6 * t - 15)))
