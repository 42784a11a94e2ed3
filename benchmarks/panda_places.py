"""Leave one place out: python benchmarks/panda_places.py

The real arms of `panda.py`, calibrated from all places but one in a single solve, each place with
its two sockets 50 mm apart; then told about the place that was left out. Three figures a place:
the mean error of the tip there; chi-square per degree of freedom of the predictions, 1 where the
intervals tell the truth, with the readings' noise as large as the misfit of the other places
says; and the distance of its sockets with its standard error, when that one is not told.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from panda import Fit, fit_rig
from panda_arm import ARMS, Choice, rig_text_of
from rich.console import Console
from rich.progress import track

from recordings.rig import parse_rig

Array = NDArray[np.float64]

CHOICE = Choice(
    noise_rad=0.10e-3,
    play_m=0.07e-3,
    length_m=0.5e-3,
    angle_rad=1.5e-3,
    encoder_rad=10e-3,
    compliance=2e-5,
    bearing=2e-5,
)
"""What `panda.py` chooses from the place front_center of panda_2_clean alone."""

TOLD_MM = 50.0


def sockets_of(place: str) -> tuple[str, str]:
    """Names of its two sockets in a rig."""
    name = place.replace("-", "_")
    return f"{name}_0", f"{name}_1"


def fit(places: tuple[str, ...], told: tuple[str, ...]) -> Fit:
    """One solve of the poses at ``places``, told the distance of the sockets at ``told``."""
    names = tuple(name for place in places for name in sockets_of(place))
    distances = [
        f'[[mechanism.distance]]\nbetween = ["{first}", "{second}"]\n'
        f"distance_mm = {{ nominal = {TOLD_MM}, uncertainty = 0.05 }}\n"
        for first, second in map(sockets_of, told)
    ]
    text = rig_text_of(CHOICE, distance=False, fixtures=names)
    return fit_rig(parse_rig(text + "".join(distances)), CHOICE, places)


def distance_mm(found: Fit, place: str) -> tuple[float, float]:
    """Distance of the sockets of ``place`` and its standard error."""
    estimate = found.estimate
    names = list(estimate.space.names)
    ends = np.array([[names.index(f"{s}.{axis}") for axis in "xyz"] for s in sockets_of(place)])
    apart = estimate.values[ends[1]] - estimate.values[ends[0]]
    length = float(np.linalg.norm(apart))
    along = np.zeros(len(names))
    along[ends[1]], along[ends[0]] = apart / length, -apart / length
    return 1e3 * length, 1e3 * float(np.sqrt(along @ estimate.spread @ along))


def main() -> None:
    console = Console(highlight=False)
    every = [(arm, place) for arm, places in ARMS.items() for place in places]
    inside = 0
    shown: dict[str, list[tuple[float, float]]] = {arm: [] for arm in ARMS}
    console.print(f"{'arm':15}{'left out':14}{'misfit':>8}{'error':>10}{'chi2':>7}   distance, mm")
    for arm, place in track(every, "places", transient=True, console=Console(stderr=True)):
        rest = tuple(other for other in ARMS[arm] if other != place)
        found = fit(rest, told=rest)
        noisier = replace(
            found,
            choice=replace(
                CHOICE,
                noise_rad=CHOICE.noise_rad * found.estimate.inflation,
                play_m=CHOICE.play_m * found.estimate.inflation,
            ),
        )
        chi2 = noisier.elsewhere(place, found.estimate.spread)
        error = found.error_mm(place)
        apart, doubt = distance_mm(fit(ARMS[arm], told=rest), place)
        off = (apart - TOLD_MM) / doubt
        inside += abs(off) < 1.96
        shown[arm].append((error, chi2))
        console.print(
            f"{arm:15}{place:14}{found.estimate.misfit:8.2f}{error:7.3f} mm{chi2:7.2f}"
            f"   {apart:.3f} +- {doubt:.3f} ({off:+.1f})"
        )
    for arm, figures in shown.items():
        error, chi2 = np.mean(figures, axis=0)
        console.print(f"{arm}: mean error {error:.3f} mm, mean chi2 {chi2:.2f}")
    console.print(f"95 % intervals that hold {TOLD_MM} mm: {inside} of {len(every)}")


if __name__ == "__main__":
    main()
