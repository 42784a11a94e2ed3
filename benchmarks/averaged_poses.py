"""Averaged poses in memory, for benchmarks that need thousands of sessions: no files, no devices.

Configurations are spread over what the mechanism reaches from home inside its limits; each
run closes some of them at a truth of its own, and reads them with the rig's stated noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.events import Dwell
from recordings.recording import Readings, Recording
from recordings.rig import Rig, load_rig, parameters, visits
from recordings.session import Session
from solver.estimate.nuisance import Observations
from solver.mechanism.model import Model, model_of
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import assembled, close, wander

Array = NDArray[np.float64]

_STEPS = 40  # from home to a target, so that every pose stays on the branch of home
_NEWTON = 6
_SAMPLE_NS = 10_000_000
_DWELL_EVERY_NS = 1_500_000_000


@dataclass(frozen=True)
class Mechanism:
    """A bundled rig, and configurations (Q, U) that it reaches at its nominal parameters."""

    rig: Rig
    model: Model
    space: ParameterSpace
    reached: Array

    @classmethod
    def named(cls, name: str, configurations: int = 450, *, planned: bool = True) -> Mechanism:
        """The bundled rig ``name``.

        Args:
            name: of the rig.
            configurations: how many.
            planned: where the drives of the rig's own plan take it, if it has drives;
                otherwise anywhere inside its limits.
        """
        rig = load_rig(name)
        model = model_of(rig)
        space = ParameterSpace.of(parameters(rig))
        if planned and rig.plan is not None and rig.plan.drives:
            reached = _driven(rig, model, space.nominal, configurations)
        else:
            reached = wander(rig, model, space.nominal, configurations, seed=1)
        return cls(rig, model, space, reached)

    def truth(self, rng: np.random.Generator) -> Array:
        """(N,) nominal values, the identified ones moved by their stated uncertainties."""
        space = self.space
        draw = rng.standard_normal(len(space.names))
        return space.expand(space.reduce(space.nominal) + space.uncertainty * draw)

    def configurations(self, truth: Array, poses: int, rng: np.random.Generator) -> Array:
        """(P, U) configurations that close at ``truth`` (N,), some of ``reached`` moved least."""
        chosen = rng.choice(len(self.reached), size=len(self.reached), replace=False)
        found, closed = close(self.model, self.reached[chosen[: poses + poses // 4]], truth)
        if closed.sum() < poses:
            raise ValueError(
                f"only {closed.sum()} of {len(closed)} configurations close, expected {poses}"
            )
        return found[closed][:poses]

    def readings(self, truth: Array, coordinates: Array) -> Array:
        """(P, C) counts without noise."""
        return self.model.linearise(coordinates, truth, self.space.expansion[:, :0]).readings

    def noise(self, samples: int) -> Array:
        """(C,) standard deviation [counts] of a mean of ``samples``."""
        return np.array([channel.noise for channel in self.rig.channels]) / np.sqrt(samples)

    def session(
        self, truth: Array, poses: int, samples: int, rng: np.random.Generator
    ) -> Observations:
        """Averaged poses with known noise."""
        exact = self.readings(truth, self.configurations(truth, poses, rng))
        sigma = np.tile(self.noise(samples), (poses, 1))
        return Observations(exact + sigma * rng.standard_normal(exact.shape), sigma)

    def recording(
        self, truth: Array, coordinates: Array, samples: int, rng: np.random.Generator
    ) -> Recording:
        """``samples`` whole counts of every channel in a dwell at each of ``coordinates`` (P, U)."""
        exact = self.readings(truth, coordinates)
        poses = len(exact)
        starts = np.arange(poses, dtype=np.int64) * _DWELL_EVERY_NS
        time = (starts[:, None] + np.arange(samples, dtype=np.int64) * _SAMPLE_NS).ravel()
        noise = self.noise(1)
        readings = {}
        for c, channel in enumerate(self.rig.channels):
            drawn = exact[:, c, None] + noise[c] * rng.standard_normal((poses, samples))
            raw = np.round(drawn).astype(np.int64).ravel()
            flags = np.zeros(len(raw), dtype=np.uint32)
            readings[channel.name] = Readings(channel.name, time, raw, None, None, flags)
        dwells = tuple(
            Dwell(int(t), int(t), int(t) + samples * _SAMPLE_NS, i, 0) for i, t in enumerate(starts)
        )
        return Recording(
            Path("in-memory"),
            self.rig,
            "",
            Session(),
            readings,
            dwells,
            marks=(),
            faults=(),
            mode_commands=(),
            mode_reports=(),
            clock=(),
            ledger={},
        )


def _driven(rig: Rig, model: Model, nominal: Array, count: int) -> Array:
    """(count, U) configurations to which the plan's drives take the mechanism from home, without jumps."""
    assert rig.plan is not None
    targets = np.array([v.targets for v in visits(rig.plan, count) if v.visit == 0])[:count]
    drives = [model.coordinate_names.index(name) for name in rig.plan.drives]
    free = np.setdiff1d(np.arange(len(model.coordinate_names)), drives)
    home = assembled(rig, model, nominal)
    u = np.tile(home, (len(targets), 1))
    for share in np.linspace(0.0, 1.0, _STEPS + 1)[1:]:
        u[:, drives] = home[drives] + share * (targets - home[drives])
        for _ in range(_NEWTON):
            at = model.linearise(u, nominal, np.zeros((len(nominal), 0)))
            jacobian = at.closure_by_coordinates[:, :, free]
            u[:, free] -= np.linalg.solve(jacobian, at.closure[:, :, None])[:, :, 0]
    return u
