"""How strong a hidden effect is: the squared length of its trace after projection, in noise units.

Nature plays the same session twice, with and without the effect, and under the same noise, so
that the difference of the dwells' mean counts is what the effect does, all its nonlinear shape
included. The plain model is fitted to readings that are changed by it and by nothing else: poses
and parameters take what they can, and the whitened residual is the trace.

Rounding to whole counts leaves a little noise in the difference. It is independent from one
draw of the noise to another, so lengths are taken between two halves of the draws: without bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.reader import read_recording
from recordings.rig import Rig
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.lag import Lag
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.nature import Nature
from sim_devices.plant.session import Played, plan_of, play
from sim_devices.plant.stop import Stop
from sim_devices.simulate import EPOCH_NS, simulate
from solver.estimate.nuisance import Observations, settle
from solver.gap.analysis import first_fit
from solver.gap.candidates import candidates
from solver.gap.fit import Fit, refit
from solver.gap.score import forms
from solver.motion import with_motion
from solver.samples import PoseTable, average

Array = NDArray[np.float64]

_DRAWS = 8
_ROUNDS = 10  # fits, each from where the last one ended
_AT_REST = 0.999  # of the last misfit: no less is left to be gained
_WATCHED_S = 0.1  # after the start: the mechanism stands until its first move


@dataclass(frozen=True)
class Trace:
    """What an effect adds to the whitened residual, in M equations and two halves of the draws.

    Attributes:
        fit: the plain model at the session that shows it.
        full: (M, 2) with the poses' coordinates following.
        left: (M, 2) what the plain model's parameters cannot take.
    """

    fit: Fit
    full: Array
    left: Array

    @property
    def strength(self) -> float:
        """lambda: squared length of what is left."""
        return _squared(self.left)

    @property
    def retained(self) -> float:
        """kappa: the fraction of the squared length that is left."""
        return self.strength / max(_squared(self.full), 1e-300)

    def beside(self, basis: Array) -> float:
        """Squared length of what is left beside an orthonormal ``basis`` (M, k)."""
        return _squared(self.left - basis @ (basis.T @ self.left))


def _refitted(fit: Fit, changed: Array) -> Trace:
    """Of what changes readings by ``changed`` (P, C, draws) [counts].

    Not to first order only: where an effect moves the poses themselves by millimetres, squares of
    that are more than noise, and the plain model takes those up as well.
    """
    predicted = fit.observed.counts - fit.residual * fit.observed.sigma
    full, left = [], []
    for draw in range(changed.shape[2]):
        observed = replace(fit.observed, counts=predicted + changed[:, :, draw])
        start = fit.settled.coordinates
        settled = settle(fit.model, observed, start, fit.parameters, fit.space.expansion[:, :0])
        again = _rested(fit, observed, settled.coordinates)
        full.append(settled.residual.ravel())
        left.append(again.residual.ravel())
    return Trace(fit, np.stack(full, axis=1), np.stack(left, axis=1))


def _rested(fit: Fit, observed: Observations, coordinates: Array) -> Fit:
    """The plain model fitted to ``observed``, until it comes to rest: effects may have moved it far."""
    parameters, left = fit.parameters, np.inf
    for _ in range(_ROUNDS):
        again = refit(fit.model.site, fit.effects, observed, parameters, coordinates)
        if again is None:
            raise BadEffect("the mechanism does not close with the effect")
        if again.rss > _AT_REST * left:
            return again
        parameters, coordinates, left = again.parameters, again.settled.coordinates, again.rss
    raise BadEffect("the plain model does not come to rest beside the effect")


def _squared(each: Array) -> float:
    """Squared length of the common part of the columns of ``each``, without that of their noise."""
    together, draws = each.sum(axis=1), each.shape[1]
    return float((together @ together - np.sum(each**2)) / (draws * (draws - 1)))


class Bench:
    """One rig with one truth, fitted to a session in which nothing is hidden.

    Args:
        rig: as described.
        rig_toml: its text.
        seed: of truth, session and noise.
        folder: for the recording of that session.

    Raises:
        SimDevicesError: the session cannot be.
        SolverError: it cannot be fitted.
    """

    def __init__(self, rig: Rig, rig_toml: str, seed: int, folder: Path) -> None:
        self._rig, self._seed = rig, seed
        file = folder / "plain.mcap"
        simulate(rig, rig_toml, file, seed=seed)
        self._recording = read_recording(file)
        file.unlink()
        self._table = average(self._recording)
        self._fit = first_fit(self._recording, self._table)
        plain = make_nature(rig, seed)
        self._without: dict[tuple[str, ...], Array] = {(): _means(plain, play(plain), seed)}

    def trace(self, effect: str, beside: tuple[str, ...] = ()) -> Trace:
        """Of one more effect where those of ``beside`` are at work; raises BadEffect as `simulate` does."""
        if beside not in self._without:
            other = make_nature(self._rig, self._seed, beside)
            self._without[beside] = _means(other, play(other), self._seed)
        nature = make_nature(self._rig, self._seed, (*beside, effect))
        told = nature.truth.effects[-1]
        if told.name == Lag.name:
            return self._lag(told.where, told.size)
        played = play(nature)
        changed = _means(nature, played, self._seed) - self._without[beside]
        for c, channel in enumerate(self._rig.channels):
            if channel.modulus_counts is not None:
                half = channel.modulus_counts / 2
                changed[:, :, c] = (changed[:, :, c] + half) % channel.modulus_counts - half
        rows = _rows(self._table, played.stops)
        halves = np.nan_to_num(changed[:, rows]).reshape(2, _DRAWS // 2, *self._table.counts.shape)
        return _refitted(self._fit, np.moveaxis(halves.mean(axis=1), 0, 2))

    def _lag(self, where: str, delay: float) -> Trace:
        """Of a channel that is read ``delay`` [s] late: it shows in motion only."""
        moving, _ = with_motion(self._recording, self._table)
        fit = first_fit(self._recording, moving)
        c = [channel.name for channel in self._rig.channels].index(where)
        changed = np.zeros((*moving.counts.shape, 2))
        if moving.rate is not None:
            late = -delay * moving.rate[:, c] / self._rig.channels[c].gain.nominal
            changed[:, c] = late[:, None]  # without noise: the two draws are the same
        return _refitted(fit, changed)

    def nearest(self, trace: Trace, name: str, where: str) -> tuple[str, float, float | None]:
        """The rival that could best stand in for ``name@where``, by the solver's linear forms.

        Returns:
            Its label, the squared length that it leaves of ``trace``, and that which the effect's
            own form leaves of it, in noise units; None where the solver has no such candidate.
        """
        tested, _ = candidates(trace.fit)
        own: float | None = None
        rivals = {"": trace.strength}
        for form in forms(trace.fit, tested):
            left, candidate = trace.beside(form.basis), tested[form.candidate]
            if (candidate.name, candidate.where) == (name, where):
                own = left if own is None else min(own, left)
            else:
                rivals[candidate.label] = min(rivals.get(candidate.label, np.inf), left)
        label = min(rivals, key=lambda rival: rivals[rival])
        return label, rivals[label], own


def _means(nature: Nature, played: Played, seed: int) -> Array:
    """(draws, 1 + stops, C) mean counts before the first move and in every stop's dwell.

    NaN where a drive did not get there.
    """
    plan, time_s = plan_of(nature), played.course.time_s
    length = max(int(plan.dwell * plan.sample), 1)
    begin = np.searchsorted(time_s, [_WATCHED_S, *(stop.rest_s for stop in played.stops)])
    inside = np.minimum(begin[:, None] + np.arange(length), len(time_s) - 1)
    failed = np.array([False, *(bool(stop.faults) for stop in played.stops)])
    out = np.empty((_DRAWS, len(inside), len(nature.rig.channels)))
    for c, channel in enumerate(nature.rig.channels):
        rng = np.random.default_rng([seed, c])
        for draw in range(_DRAWS):
            noise = np.zeros(len(time_s))
            noise[inside] = rng.standard_normal(inside.shape)
            counts = nature.sensors[channel.name].counts(played.course, rng, noise)
            out[draw, :, c] = counts[inside].mean(axis=1)
    out[:, failed] = np.nan
    return out


def _rows(table: PoseTable, stops: Sequence[Stop]) -> NDArray[np.intp]:
    """(P,) the stop in which each dwell of ``table`` lies, from 1; 0 before the first move."""
    middle = np.array([0.5 * (w.start_ns + w.end_ns) - EPOCH_NS for w in table.windows]) * 1e-9
    leaves = np.array([stops[0].start_s, *(stop.leave_s for stop in stops)])
    return np.minimum(np.searchsorted(leaves, middle), len(stops)).astype(np.intp)
