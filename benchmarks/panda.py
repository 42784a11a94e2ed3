"""A real arm, a real socket: python benchmarks/panda.py

The arm of `panda_arm.py`, trained on the place `front_center` alone, tested on the seven other
places to which the tool was bolted. The figure is the published tool's: the mean distance of
the model's tip positions in one socket from their own mean, averaged over both sockets.

How uncertain lengths, angles and encoder zeros are, how noisy the joints, how much play the ball
has in its socket, and how much the joints may give way under the arm's weight, is decided by the
marginal likelihood of the training place (Laplace's approximation), never by a test place.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, replace
from sys import stderr

import numpy as np
from numpy.typing import NDArray
from panda_arm import ARMS, PLACES, TRAINED, Choice, observed, poses, rig_of
from rich.console import Console
from rich.progress import track

from recordings.rig import Rig, parameters
from solver.effects.needs import loaded
from solver.estimate import likelihood
from solver.estimate.estimate import Estimate
from solver.estimate.nuisance import Observations
from solver.estimate.robust import Loss
from solver.forward import Forward, forward, read
from solver.mechanism.model import Model, model_of
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]

RIGID = (0.0, 0.0)
GRID = tuple(
    Choice(*sizes, *elastic)
    for sizes in itertools.product(
        (0.10e-3, 0.14e-3, 0.20e-3),
        (0.05e-3, 0.07e-3, 0.09e-3),
        (0.5e-3, 1e-3),
        (1.5e-3, 3e-3),
        (10e-3,),
    )
    for elastic in (RIGID, (2e-5, 0.0), (5e-5, 0.0), (0.0, 2e-5), (2e-5, 2e-5), (5e-5, 5e-5))
)


@dataclass(frozen=True)
class Fit:
    """A calibration from one place."""

    choice: Choice
    model: Model
    observed: Observations
    estimate: Estimate
    took_s: float

    @property
    def evidence(self) -> float:
        """Log marginal likelihood of the place, up to a constant."""
        estimate, space = self.estimate, self.estimate.space
        at = self.model.linearise(
            estimate.coordinates, estimate.parameters, space.expansion, self.observed.at
        )
        gains = np.array([p.nominal for p in space.table if p.name.endswith(".gain")])
        spread = at.closure_by_coordinates * (self.observed.sigma * gains)[:, None, :]
        closing = np.linalg.slogdet(spread @ np.swapaxes(spread, 1, 2))[1].sum()
        width = np.where(np.isfinite(space.uncertainty), space.uncertainty, 1.0)
        information = (estimate.jacobian * width).T @ (estimate.jacobian * width)
        fit = float(estimate.residual @ estimate.residual)
        return -0.5 * float(fit + closing + np.linalg.slogdet(information)[1])

    def forward(self, place: str) -> Forward:
        """The tip at the readings of ``place``, whatever socket held it."""
        x, seen = self.estimate.parameters, observed((place,), self.choice)
        seen = loaded(self.model, seen, read(self.model, seen.counts, x), x, None)
        return forward(self.model, seen, x, self.estimate.space.expansion)

    def tips(self, place: str) -> tuple[Array, NDArray[np.intp]]:
        """Tip positions (P, 3) [m] at the readings of ``place``, and their sockets."""
        return self.forward(place).end.position, poses(place)[1]

    def elsewhere(self, place: str, covariance: Array) -> float:
        """Chi-square per degree of freedom at ``place``: noise, and the covariance (n, n) of the parameters."""
        found = self.forward(place)
        end, slopes = found.end, found.end.by_parameters[:, :3]
        noisy = found.by_readings[:, :3] * observed((place,), self.choice).sigma[:, None, :]
        sockets, total, freedoms = poses(place)[1], 0.0, 0
        for k in (0, 1):
            rows = np.flatnonzero(sockets == k)
            tall = slopes[rows].reshape(3 * len(rows), -1)
            spread = tall @ covariance @ tall.T
            for i, pose in enumerate(rows):
                spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += noisy[pose] @ noisy[pose].T
            where, right = np.tile(np.eye(3), (len(rows), 1)), end.position[rows].ravel()
            weighted = np.linalg.solve(spread, np.column_stack([where, right]))
            socket = np.linalg.solve(where.T @ weighted[:, :3], where.T @ weighted[:, 3])
            left = right - where @ socket
            total += float(left @ np.linalg.solve(spread, left))
            freedoms += 3 * len(rows) - 3
        return total / freedoms

    def error_mm(self, place: str) -> float:
        """Mean distance of tip positions from the mean of their socket."""
        at, sockets = self.tips(place)
        each = [at[sockets == k] for k in (0, 1)]
        return 1e3 * float(np.mean([np.linalg.norm(p - p.mean(0), axis=1).mean() for p in each]))

    def apart_mm(self, place: str) -> float:
        """Distance between the sockets' mean positions."""
        at, sockets = self.tips(place)
        return 1e3 * float(np.linalg.norm(at[sockets == 1].mean(0) - at[sockets == 0].mean(0)))


def fit(place: str, choice: Choice, *, distance: bool = True, loss: Loss = Loss.NONE) -> Fit:
    return fit_rig(rig_of(choice, distance=distance), choice, (place,), loss)


def fit_rig(rig: Rig, choice: Choice, places: tuple[str, ...], loss: Loss = Loss.NONE) -> Fit:
    """Calibrate ``rig`` from ``places``, the k-th of which has its fixtures 2 k and 2 k + 1."""
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    seen = observed(places, choice)
    start = time.perf_counter()
    seen = loaded(model, seen, read(model, seen.counts, space.nominal), space.nominal, None)
    estimate = likelihood.identify(model, space, seen, use_priors=True, loss=loss)
    return Fit(choice, model, seen, estimate, time.perf_counter() - start)


def others(found: Fit, trained: str = TRAINED) -> list[float]:
    return [found.error_mm(place) for place in PLACES if place != trained]


def held_out(place: str, choice: Choice) -> tuple[float, float]:
    """Socket distance and its standard error [mm] from ``place`` alone, the distance not told."""
    estimate = fit(place, choice, distance=False).estimate
    names = list(estimate.space.names)
    ends = np.array([[names.index(f"hole_{k}.{axis}") for axis in "xyz"] for k in (0, 1)])
    apart = estimate.values[ends[1]] - estimate.values[ends[0]]
    length = float(np.linalg.norm(apart))
    along = np.zeros(len(names))
    along[ends[1]], along[ends[0]] = apart / length, -apart / length
    error = float(np.sqrt(along @ estimate.spread @ along))
    return 1e3 * length, 1e3 * error


def intervals(arm: str, places: tuple[str, ...], choice: Choice) -> None:
    """Print how honest intervals from each place alone are: at the other places, and of the socket distance."""
    print(f"\n{arm}: each place calibrated alone")
    print(
        f"{'place':16}{'misfit':>8}{'alike':>8}{'chi2 elsewhere: noise, widened':>34}   socket distance held out [mm]"
    )
    misses, shown = [], []
    for place in places:
        found = fit(place, choice)
        estimate = found.estimate
        alike = 0.0 if estimate.correlation is None else estimate.correlation.score
        chi2 = [
            float(np.mean([found.elsewhere(other, spread) for other in places if other != place]))
            for spread in (estimate.covariance, estimate.spread)
        ]
        shown.append(chi2)
        apart, error = held_out(place, choice)
        misses.append((apart - 50.0) / error)
        print(
            f"{place:16}{estimate.misfit:8.2f}{alike:8.1f}{chi2[0]:24.2f}{chi2[1]:10.2f}"
            f"{apart:12.3f} +- {error:.3f} ({misses[-1]:+.1f})"
        )
    inside = sum(abs(miss) < 1.96 for miss in misses)
    mean = np.mean(shown, axis=0)
    print(f"chi2 elsewhere, mean: {mean[0]:.2f} by noise alone, {mean[1]:.2f} with wider intervals")
    print(f"95 % intervals that hold 50.0: {inside} of {len(places)}")


def main() -> None:
    evidence = {
        choice: fit(TRAINED, choice).evidence
        for choice in track(
            GRID,
            "choices",
            console=Console(stderr=True),
            transient=True,
            disable=not stderr.isatty(),
        )
    }
    best = max(GRID, key=lambda choice: evidence[choice])
    likeliest: dict[tuple[float, float], Choice] = {}
    for choice in sorted(GRID, key=lambda choice: evidence[choice]):
        likeliest[choice.compliance, choice.bearing] = choice
    stiff = likeliest[RIGID]
    print(f"chosen by the marginal likelihood of {TRAINED} out of {len(GRID)}: {best}")
    rigid = fit(TRAINED, stiff)
    print(
        "\nsprings about, across the axes [µrad/Nm]; log evidence above the best rigid arm; test [mm]"
    )
    for springs, choice in likeliest.items():
        print(
            f"{1e6 * springs[0]:12.0f}, {1e6 * springs[1]:3.0f}{evidence[choice] - evidence[stiff]:20.1f}"
            f"{np.mean(others(fit(TRAINED, choice))):20.3f}"
        )
    plain, robust = fit(TRAINED, best), fit(TRAINED, best, loss=Loss.HUBER)
    nominal = rig_of(best)
    x = np.array([p.nominal for p in parameters(nominal)])
    before = replace(plain, estimate=replace(plain.estimate, parameters=x))
    print(f"\n{'mean error [mm]':46}{'train':>8}{'test':>8}{'seconds':>9}")
    rows = [("nominal", before, None), ("this program", plain, plain.took_s)]
    rows.insert(1, ("this program, rigid joints", rigid, rigid.took_s))
    rows.append(("this program, Huber's loss", robust, robust.took_s))
    for name, found, took in rows:
        shown = "" if took is None else f"{took:9.3f}"
        print(f"{name:46}{found.error_mm(TRAINED):8.3f}{np.mean(others(found)):8.3f}{shown}")
    print(f"{'published tool':46}{0.168:8.3f}{0.347:8.3f}{5.0:9.3f}")
    print(f"{'Gauss-Newton, 2 mm and 10 mrad (reference)':46}{0.165:8.3f}{0.363:8.3f}{0.020:9.3f}")
    print(f"\n{'place':16}{'error [mm]':>12}{'socket distance [mm], known as 50.0':>40}")
    for place in PLACES:
        print(f"{place:16}{robust.error_mm(place):12.3f}{robust.apart_mm(place):40.3f}")
    found = zip(plain.estimate.space.names, plain.estimate.values, strict=True)
    springs_found = [1e6 * value for name, value in found if "compliance@" in name]
    print(f"\nsprings found: {min(springs_found):.0f} to {max(springs_found):.0f} µrad/Nm")
    for arm, places in ARMS.items():
        intervals(arm, places, best)
    print(f"misfit of {TRAINED}: {plain.estimate.misfit:.2f}")
    ratio = np.mean(others(robust)) / robust.error_mm(TRAINED)
    print(
        f"unexplained: the error elsewhere is {ratio:.1f} times that of the training place, which noise and "
        "geometry do not account for"
    )


if __name__ == "__main__":
    main()
