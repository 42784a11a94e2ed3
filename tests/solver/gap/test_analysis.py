"""What is hidden is named, what is not is not, and twins are told as twins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import read_recording
from recordings.rig import DescribedEffect, Quantity, load_rig, parse_rig, rig_text
from recordings.rig.edit import with_effect
from sim_devices.simulate import simulate
from sim_devices.truth import Truth
from solver.gap.analysis import analyse
from solver.gap.floor import same_poses
from solver.gap.result import Gap, Verdict, gap_json
from solver.samples import average


def analysed(tmp_path: Path, rig: str, seed: int, *hide: str) -> tuple[Gap, Truth]:
    path = tmp_path / "r.mcap"
    truth = simulate(load_rig(rig), rig_text(rig)[0], path, seed=seed, hide=hide)
    return analyse(read_recording(path)), truth


@pytest.mark.parametrize(
    ("rig", "hide"),
    [
        ("arm", "backlash@q6=0.15"),
        ("arm", "joint-compliance@joint6=0.02"),
        ("shoulder", "nonlinearity@d3=1%"),
        ("shoulder", "stuck-bit@d2=0.00094"),
    ],
)
def test_what_is_hidden_is_named_and_measured(tmp_path: Path, rig: str, hide: str) -> None:
    gap, truth = analysed(tmp_path, rig, 3, hide)
    (hidden,) = truth.effects
    effect = gap.effects[0]
    group = {(effect.name, effect.where), *((r.name, r.where) for r in effect.could_also_be)}
    assert gap.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert (hidden.name, hidden.where) in group
    if (effect.name, effect.where) == (hidden.name, hidden.where):
        assert effect.unit == hidden.unit
        # Nature's forms are not the solver's: a tenth of the size beside what noise allows.
        allowed = 4.0 * effect.standard_error + 0.1 * abs(hidden.size)
        assert abs(abs(effect.size) - abs(hidden.size)) < allowed
    assert gap.held_out is not None
    assert gap.held_out.after < 1.15
    assert gap.held_out.after < gap.held_out.before


def test_clean_data_names_nothing_and_says_what_it_would_have_seen(tmp_path: Path) -> None:
    gap, _ = analysed(tmp_path, "shoulder", 2)
    assert gap.verdict is Verdict.NOTHING
    assert not gap.effects
    assert not gap.provisional
    assert gap.held_out is not None
    assert gap.held_out.closed is None
    sizes = {(limit.name, limit.where): limit.size for limit in gap.limits}
    assert 0 < sizes["gain-error", "d1"] < 0.1
    json = gap_json(gap)
    assert json["verdict"] == "nothing-detectable"
    assert json["effects"] == []


def test_poses_set_by_hand_count_as_one_where_they_nearly_coincide(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    simulate(load_rig("shoulder"), rig_text("shoulder")[0], path, seed=2)
    table = average(read_recording(path))
    poses = same_poses(table.windows, table.counts)
    count = np.bincount(poses)
    assert 8 <= np.sum(count > 1) <= 20
    assert np.sum(count[count > 1] - 1) >= 16


def test_numbers_of_poses_are_believed(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    simulate(load_rig("arm"), rig_text("arm")[0], path, seed=2)
    table = average(read_recording(path))
    assert len(np.unique(same_poses(table.windows, table.counts))) == 60
    fixtures = tuple(replace(w, fixture=f"f{i % 2}") for i, w in enumerate(table.windows))
    assert len(np.unique(same_poses(fixtures, table.counts))) > 60


def test_a_parameter_that_no_reading_tells_from_another_is_told_with_it(tmp_path: Path) -> None:
    gap, truth = analysed(tmp_path, "arm", 1, "link-geometry@joint5.s=-0.00005")
    (effect,) = gap.effects
    (hidden,) = truth.effects
    assert gap.verdict is Verdict.AMBIGUOUS
    twin = next(r for r in effect.could_also_be if r.where == "joint5.s")
    assert (effect.where, twin.log_evidence) == ("joint3.s", 0.0)
    assert abs(twin.size - hidden.size) < 4.0 * twin.standard_error


def test_a_zero_that_comes_to_rest_early_is_among_the_names(tmp_path: Path) -> None:
    # In an eighth of the session all is over; where so few poses show it, others of the loop look alike.
    text = rig_text("shoulder")[0]
    warming = {"rate": Quantity(1e-4, "speed"), "decay": Quantity(0.12, "rate")}
    grown = with_effect(text, DescribedEffect("offset-drift", "d2", warming))
    simulate(parse_rig(grown), grown, tmp_path / "r.mcap", seed=11)
    gap = analyse(replace(read_recording(tmp_path / "r.mcap"), rig=load_rig("shoulder")))
    (effect,) = gap.effects
    group = {(effect.name, effect.where), *((r.name, r.where) for r in effect.could_also_be)}
    assert ("offset-drift", "d2") in group
    decay = effect.entry.values["decay"]
    assert decay.uncertainty is not None
    assert abs(decay.nominal - 0.12) < 4.0 * decay.uncertainty < 0.1
