"""One contract, two programs: what nature plays of a described effect, the solver finds again.

Nature and the solver share no formula; signs, places and units agree only if both follow the file format.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import DescribedEffect, Quantity, parse_rig, rig_text
from recordings.rig.edit import with_effect
from sim_devices.simulate import simulate
from solver.solve import solve

A, L = "angle", "length"
Given = dict[str, tuple[float, str]]

CASES: list[tuple[str, str, str, Given, Given]] = [
    ("arm", "eccentricity", "q1", {"cos": (2e-3, A), "sin": (1e-3, A)}, {}),
    (
        "arm",
        "cyclic-error",
        "q6",
        {"cos": (2e-3, A), "sin": (-3e-3, A)},
        {"harmonic": (8, "ratio")},
    ),
    ("arm", "backlash", "q6", {"gap": (5e-3, A)}, {}),
    ("arm", "offset-drift", "q7", {"rate": (1e-4, "angular speed")}, {}),
    ("arm", "offset-jump", "q4", {"step": (2e-3, A)}, {"at": (30.0, "time")}),
    ("arm", "crosstalk", "q6<-q7", {"ratio": (0.01, "ratio")}, {}),
    ("shoulder", "joint-compliance", "leg2", {"compliance": (5e-5, "compliance")}, {}),
    ("arm", "bearing-compliance", "joint3", {"compliance": (2e-4, "angular compliance")}, {}),
    ("arm", "fixture-compliance", "fixture", {"compliance": (1e-5, "compliance")}, {}),
    (
        "shoulder",
        "fixture-slip",
        "fixture",
        {"x": (1e-3, L), "y": (-5e-4, L), "z": (8e-4, L)},
        {"at": (60.0, "time")},
    ),
    ("arm", "link-geometry", "joint3.s", {"change": (2e-3, L)}, {}),
    ("arm", "axis-offset", "joint4", {"offset": (1e-3, L)}, {}),
    ("arm", "thermal-growth", "links", {"rate": (1e-5, "rate")}, {}),
    ("arm", "thermal-growth", "links", {"rate": (2e-5, "rate"), "decay": (0.02, "rate")}, {}),
    (
        "shoulder",
        "offset-drift",
        "d2",
        {"rate": (-2e-5, "speed"), "decay": (0.01, "rate")},
        {},
    ),
]


@pytest.mark.parametrize(("name", "effect", "where", "true", "settings"), CASES)
def test_what_nature_plays_is_found(
    tmp_path: Path, name: str, effect: str, where: str, true: Given, settings: Given
) -> None:
    fixed = {part: Quantity(*value) for part, value in settings.items()}
    playing = {part: Quantity(*value) for part, value in true.items()} | fixed
    text = with_effect(rig_text(name)[0], DescribedEffect(effect, where, playing))
    simulate(parse_rig(text), text, tmp_path / "r.mcap", seed=11)
    recording = read_recording(tmp_path / "r.mcap")
    asked = {part: Quantity(0.0, unit, None, True) for part, (_, unit) in true.items()} | fixed
    rig = recording.rig.model_copy(update={"effects": (DescribedEffect(effect, where, asked),)})
    estimate = solve(replace(recording, rig=rig), poses=10_000).estimate
    k = [estimate.space.names.index(f"{effect}@{where}.{part}") for part in true]
    found = estimate.parameters[estimate.space.identified[k]]
    error = found - [value for value, _ in true.values()]
    distance = error @ np.linalg.solve(estimate.covariance[np.ix_(k, k)], error)
    assert distance < 16.0 * len(k)
    assert estimate.misfit < 1.4
