"""Averaged readings of simulated mechanisms, for benchmarks: nature's own kinematics, no files.

Poses are those of the rig's plan; each channel is read ``samples`` times at each of them, in
whole counts, and averaged.
"""

from __future__ import annotations

import numpy as np

from recordings.rig import Rig, parameters
from sim_devices.plant.creation import make_nature
from sim_devices.plant.motion import Course
from sim_devices.plant.session import resting
from solver.estimate.nuisance import Observations


def averaged_nature(
    rig: Rig, seed: int, poses: int, samples: int
) -> tuple[np.ndarray, Observations]:
    """True parameters (N,) SI, and averaged readings of the first visits of ``poses`` poses."""
    nature = make_nature(rig, seed)
    rng = np.random.default_rng([seed, 9])
    still = resting(nature, poses)
    columns = []
    for channel in rig.channels:
        value = still[channel.name][:poses]
        many = np.repeat(value, samples)
        course = Course(
            np.arange(len(many), dtype=float),
            {channel.name: many},
            {channel.name: np.zeros(len(many))},
        )
        raw = nature.sensors[channel.name].counts(course, rng)
        columns.append(raw.reshape(-1, samples).mean(axis=1))
    counts = np.stack(columns, axis=1)
    noise = np.array([np.hypot(channel.noise, np.sqrt(1 / 12)) for channel in rig.channels])
    truth = np.array([nature.truth.parameters[p.name] for p in parameters(rig)])
    return truth, Observations(counts, np.tile(noise / np.sqrt(samples), (len(counts), 1)))
