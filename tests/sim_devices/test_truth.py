"""Truth: what is drawn, what follows, and the file that tells it."""

import json

import numpy as np
import pytest

from recordings.rig import load_rig, parameters
from sim_devices.plant.errors import TruthNotWritten
from sim_devices.truth import HiddenEffect, draw_truth, truth_json, write_truth


def test_only_identified_parameters_with_an_uncertainty_are_drawn(arm):
    truth = draw_truth(arm, 3)
    for parameter in parameters(arm):
        drawn = truth.parameters[parameter.name] != parameter.nominal
        assert drawn == (parameter.identify and parameter.uncertainty is not None)


def test_draws_have_the_stated_uncertainty(arm):
    drawn = [p for p in parameters(arm) if p.identify]
    z = np.array(
        [
            [(truth.parameters[p.name] - p.nominal) / p.uncertainty for p in drawn]
            for truth in (draw_truth(arm, seed) for seed in range(200))
        ]
    )
    assert len(drawn) == 14
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=0.3)
    np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.2)


def test_ties_follow(shoulder):
    truth = draw_truth(shoulder, 1).parameters
    assert truth["A3.x"] == -truth["A2.x"] != 28.8e-3
    assert truth["A3.y"] == -truth["A2.y"]
    assert truth["A4.x"] == -truth["A1.x"]


def test_the_same_seed_draws_the_same_and_another_another():
    rig = load_rig("arm")
    assert draw_truth(rig, 5) == draw_truth(rig, 5)
    assert draw_truth(rig, 5).parameters != draw_truth(rig, 6).parameters


def test_the_file_is_as_designed(arm, tmp_path):
    from dataclasses import replace

    effect = HiddenEffect("nonlinearity", "q6", 0.4, "deg")
    truth = replace(draw_truth(arm, 2), effects=(effect,))
    write_truth(truth, tmp_path / "truth.json")
    document = json.loads((tmp_path / "truth.json").read_text("utf-8"))
    assert list(document) == ["schema", "seed", "parameters", "effects"]
    assert (document["schema"], document["seed"]) == (1, 2)
    assert document["effects"] == [
        {"name": "nonlinearity", "where": "q6", "size": 0.4, "unit": "deg"}
    ]
    assert list(document["parameters"]) == [p.name for p in parameters(arm)]
    shown = document["parameters"]
    assert shown["joint1.alpha"] == pytest.approx(90.0)
    assert shown["joint3.s"] == 0.355
    assert shown["q6.gain"] == pytest.approx(0.0439453125)
    assert shown["joint2.theta_offset"] == pytest.approx(
        np.rad2deg(truth.parameters["joint2.theta_offset"])
    )


def test_lengths_are_told_in_metres(shoulder):
    shown = json.loads(truth_json(draw_truth(shoulder, 0)))["parameters"]
    assert shown["B1.x"] == pytest.approx(0.0245)
    assert shown["d1.gain"] == pytest.approx(0.029296875e-3)


def test_nothing_is_overwritten(arm, tmp_path):
    path = tmp_path / "truth.json"
    path.write_text("mine")
    with pytest.raises(TruthNotWritten, match="exists already"):
        write_truth(draw_truth(arm, 0), path)
    assert path.read_text() == "mine"
    with pytest.raises(TruthNotWritten, match="cannot write"):
        write_truth(draw_truth(arm, 0), tmp_path / "no" / "such" / "folder.json")
