"""Hidden effects: how they are asked for, what they do, and the seams for those to come."""

import dataclasses

import numpy as np
import pytest

from recordings.rig import parse_rig
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.effects.registry import EFFECT_KINDS
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import Course
from sim_devices.plant.nature import nature_of
from sim_devices.plant.session import play, resting
from sim_devices.truth import draw_truth


def seen(nature, channel, values):
    """What a channel reads [rad or m] at rest at ``values``, through nominal gain, noise averaged out."""
    values = np.asarray(values, dtype=float)
    every = {name: np.repeat(values, 400) for name in nature.sensors}
    course = Course(np.arange(len(values) * 400) * 0.01, every, every)
    counts = nature.sensors[channel].counts(course, np.random.default_rng(0))
    described = nature.rig.channel(channel)
    mean = counts.reshape(len(values), 400).mean(axis=1) - described.zero_count
    return mean * described.gain.nominal


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonlinearity", "NAME@WHERE=SIZE.*gain-error, nonlinearity"),
        ("nonlinearity@q6", "NAME@WHERE=SIZE"),
        ("nonlinearity@=2%", "NAME@WHERE=SIZE"),
        ("bendiness@q6=2%", "no effect 'bendiness'; expected one of: gain-error, nonlinearity"),
        ("nonlinearity@joint6=2%", "cannot sit at 'joint6'.*q1, q2, q3, q4, q5, q6, q7"),
        ("nonlinearity@q6=much", "size of 'nonlinearity' is 'much'"),
        ("nonlinearity@q6=0", "other than 0"),
        ("nonlinearity@q6=-1%", "expected above 0"),
        ("nonlinearity@q6=50%", "at most 10%"),
        ("nonlinearity@q6=90", "more than 20% of full scale"),
        ("gain-error@q3=80%", "at most 0.5"),
        ("gain-error@q3=nan", "size of 'gain-error' is 'nan'"),
    ],
)
def test_a_bad_wish_is_one_clear_error(arm, text, message):
    with pytest.raises(BadEffect, match=message):
        make_nature(arm, 0, [text])


def test_the_same_effect_twice_is_an_error(arm):
    with pytest.raises(BadEffect, match="'gain-error@q1' is hidden twice"):
        make_nature(arm, 0, ["gain-error@q1=1%", "gain-error@q1=2%"])


@pytest.mark.parametrize("seed", range(3))
def test_nonlinearity_in_percent_is_its_peak_over_full_scale(arm, seed):
    nature = make_nature(arm, seed, ["nonlinearity@q6=2%"])
    at = np.linspace(np.deg2rad(-89), np.deg2rad(89), 90)
    departure = np.rad2deg(seen(nature, "q6", at) - at)
    line = np.polyval(np.polyfit(at, departure, 1), at)
    assert np.abs(departure).max() == pytest.approx(0.02 * 180, rel=0.1)
    assert np.abs(line).max() < 0.5
    np.testing.assert_allclose(seen(nature, "q7", at), at, atol=np.deg2rad(0.02))


def test_nonlinearity_as_a_number_is_its_rms_over_the_travel(arm):
    nature = make_nature(arm, 3, ["nonlinearity@q6=0.5"])
    (told,) = nature.truth.effects
    assert (told.name, told.where, told.unit) == ("nonlinearity", "q6", "deg")
    assert told.size == pytest.approx(0.5)
    at = resting(nature)["q6"]
    departure = np.rad2deg(seen(nature, "q6", at) - at)
    rest = departure - np.polyval(np.polyfit(at, departure, 1), at)
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(0.5, rel=0.03)


def test_truth_tells_the_rms_of_a_size_in_percent(shoulder):
    nature = make_nature(shoulder, 0, ["nonlinearity@d2=1%"])
    (told,) = nature.truth.effects
    at = resting(nature)["d2"]
    offset = nature.truth.parameters["d2.offset"]
    departure = seen(nature, "d2", at) + offset - at
    rest = departure - np.polyval(np.polyfit(at, departure, 1), at)
    assert told.unit == "m"
    assert told.size == pytest.approx(np.sqrt(np.mean(rest**2)), rel=0.05)
    assert 0.0 < told.size < 0.01 * 0.12


def test_nonlinearity_differs_by_seed(arm):
    at = np.linspace(-1, 1, 20)
    one = seen(make_nature(arm, 0, ["nonlinearity@q6=2%"]), "q6", at)
    other = seen(make_nature(arm, 1, ["nonlinearity@q6=2%"]), "q6", at)
    assert np.abs(one - other).max() > np.deg2rad(0.5)


def test_a_drive_servoes_to_what_its_bent_sensor_reads(arm):
    nature = make_nature(arm, 0, ["nonlinearity@q6=2%"])
    played = play(nature)
    rng = np.random.default_rng(0)
    raw = nature.sensors["q6"].counts(played.course, rng)
    for stop in played.stops:
        dwell = (played.course.time_s > stop.rest_s) & (played.course.time_s < stop.leave_s)
        assert raw[dwell].mean() == pytest.approx(stop.targets["joint6"], abs=2.0)


def test_gain_error_changes_the_true_gain(arm):
    plain = make_nature(arm, 0).truth
    wrong = make_nature(arm, 0, ["gain-error@q3=0.5%"]).truth
    assert wrong.parameters["q3.gain"] == pytest.approx(1.005 * plain.parameters["q3.gain"])
    same = set(plain.parameters) - {"q3.gain"}
    assert all(wrong.parameters[name] == plain.parameters[name] for name in same)
    told = wrong.effects[0]
    assert (told.name, told.where, told.size, told.unit) == ("gain-error", "q3", 0.005, "1")


def test_gain_error_as_a_ratio(arm):
    assert make_nature(arm, 0, ["gain-error@q3=-0.01"]).truth.effects[0].size == -0.01


def test_random_is_chosen_by_seed(arm):
    chosen = {make_nature(arm, seed, ["random"], poses=4).truth.effects[0] for seed in range(12)}
    assert {effect.name for effect in chosen} <= set(EFFECT_KINDS)
    assert len({effect.name for effect in chosen}) > 5
    assert len({effect.where for effect in chosen}) > 3
    again = make_nature(arm, 4, ["random"], poses=4).truth.effects
    assert again == make_nature(arm, 4, ["random"], poses=4).truth.effects


def test_two_random_effects_differ(arm):
    for seed in range(6):
        one, two = make_nature(arm, seed, ["random", "random"], poses=4).truth.effects
        assert (one.name, one.where) != (two.name, two.where)


def test_hiding_does_not_change_what_else_is_drawn(arm):
    plain = make_nature(arm, 7).truth.parameters
    assert make_nature(arm, 7, ["nonlinearity@q7=1%"]).truth.parameters == plain


def test_without_a_plan_the_travel_is_full_scale(four_bar_text):
    text = four_bar_text.partition("[plan]")[0].replace(
        'senses = "elbow"', 'senses = "elbow"\ncount_range = [-9000, 9000]'
    )
    nature = make_nature(parse_rig(text), 0, ["nonlinearity@c2=1%"])
    assert 0.1 < nature.truth.effects[0].size < 1.8


class Drift(Effect):
    """The zero of a channel creeps with time; stands for all that knows time, rate and history."""

    name = "drift"

    @classmethod
    def places(cls, rig):
        return tuple(channel.name for channel in rig.channels)

    @classmethod
    def typical(cls, rig, where, rng):
        return "1"

    @classmethod
    def make(cls, request):
        return cls(request.where, float(request.size), "deg")

    def seen(self, channel, value, course):
        return value + self.size * course.time_s if channel == self.where else value


class StuckBit(Drift):
    """Stands for what happens to counts."""

    name = "stuck"

    def seen(self, channel, value, course):
        return value

    def counts(self, channel, counts):
        return counts | 8 if channel == self.where else counts


class Slip(Drift):
    """The fixture moves at one moment; stands for all that acts on the mechanism."""

    name = "slip"

    def seen(self, channel, value, course):
        return value

    def geometry(self, geometry, time_s, coordinates):
        shift = np.where(time_s[:, None] > 5.0, [[self.size, 0.0, 0.0]], 0.0)
        return dataclasses.replace(geometry, fixture_shift=shift)


def test_effects_of_time_counts_and_mechanism_have_a_place(arm):
    truth = draw_truth(arm, 0)
    plain = nature_of(arm, truth)
    reached = play(plain, 8)

    drifting = nature_of(arm, truth, [Drift("q3", 1e-3, "deg")])
    one = plain.sensors["q3"].counts(reached.course, np.random.default_rng(0))
    two = drifting.sensors["q3"].counts(reached.course, np.random.default_rng(0))
    drift = (two - one) * np.deg2rad(0.0009)
    np.testing.assert_allclose(drift, 1e-3 * reached.course.time_s, atol=np.deg2rad(0.0018))

    stuck = nature_of(arm, truth, [StuckBit("q6", 1.0, "deg")])
    raw = stuck.sensors["q6"].counts(reached.course, np.random.default_rng(0))
    assert np.all(raw & 8)

    slipped = play(nature_of(arm, truth, [Slip("fixture", 2e-3, "m")]), 8)
    moved = np.abs(slipped.course.value["q1"] - reached.course.value["q1"])
    early = reached.course.time_s <= 5.0
    assert moved[early].max() < 1e-9
    assert moved[~early].min() > 1e-5
