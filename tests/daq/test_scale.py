"""Counts and readings, where the counter wraps and where it does not."""

from __future__ import annotations

import math

import pytest

from daq.errors import PlanNotPossible
from daq.scale import scale_of
from recordings.rig import load_rig


@pytest.mark.parametrize("joint", ["joint1", "joint6"])
@pytest.mark.parametrize("degrees", [-80.0, 0.0, 45.0, 85.0])
def test_counts_and_value_are_inverse(joint, degrees):
    scale = scale_of(load_rig("arm"), joint)
    value = math.radians(degrees)
    assert scale.value(scale.counts(value)) == pytest.approx(value, abs=abs(scale.gain))


def test_known_counts_of_the_arm():
    rig = load_rig("arm")
    assert scale_of(rig, "joint1").counts(math.radians(90.0)) == 300_000
    assert scale_of(rig, "joint6").counts(math.radians(45.0)) == 2048 + 1024


def test_a_wrapping_channel_shows_every_angle_within_its_range():
    scale = scale_of(load_rig("arm"), "joint1")
    assert scale.counts(math.radians(190.0)) == scale.counts(math.radians(-170.0))
    assert 0 <= scale.counts(math.radians(-179.0)) <= 399_999


def test_away_takes_the_short_way_around():
    scale = scale_of(load_rig("arm"), "joint1")
    away = scale.away(math.radians(179.0), math.radians(-179.0))
    assert away == pytest.approx(math.radians(-2.0))


def test_a_value_that_cannot_be_shown_is_refused():
    with pytest.raises(PlanNotPossible, match=r"q6.*count_range \[0, 4095\]"):
        scale_of(load_rig("arm"), "joint6").counts(math.radians(120.0))


def test_an_unsensed_joint_cannot_be_driven():
    with pytest.raises(PlanNotPossible, match="no channel senses 'hinge'"):
        scale_of(load_rig("arm"), "hinge")
