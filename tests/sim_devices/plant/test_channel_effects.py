"""Effects that sit at channels: what they do to what is read, that size is as told, and nothing else."""

from __future__ import annotations

import json

import numpy as np
import pytest

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.registry import EFFECT_KINDS
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import sampled_course
from sim_devices.plant.session import play, rests

AT_CHANNELS = {
    "arm": [
        ("gain-error", "q3", "1%"),
        ("nonlinearity", "q7", "1%"),
        ("eccentricity", "q3", "0.1"),
        ("cyclic-error", "q2", "0.05"),
        ("backlash", "q7", "0.2"),
        ("offset-drift", "q4", "0.002"),
        ("offset-jump", "q1", "-0.1"),
        ("lag", "q3", "0.02"),
        ("crosstalk", "q7<-q6", "1%"),
        ("stuck-bit", "q7", "0.35"),
        ("saturation", "q7", "2"),
    ],
    "shoulder": [
        ("gain-error", "d3", "1%"),
        ("nonlinearity", "d2", "1%"),
        ("backlash", "d1", "1e-4"),
        ("offset-drift", "d4", "2e-6"),
        ("offset-jump", "d1", "1e-4"),
        ("lag", "d3", "0.02"),
        ("crosstalk", "d2<-d1", "1%"),
        ("stuck-bit", "d2", "1e-4"),
        ("saturation", "d3", "2e-3"),
    ],
}
CASES = [(rig, *case) for rig, cases in AT_CHANNELS.items() for case in cases]


@pytest.fixture(scope="module")
def bare():
    """By name: a rig, its nature without effects, and a short session of it."""
    out = {}
    for name in AT_CHANNELS:
        text, source = rig_text(name)
        rig = parse_rig(text, source)
        nature = make_nature(rig, 5)
        out[name] = rig, nature, play(nature, 6)
    return out


def read(nature, course, channel):
    """Counts of a channel along a course, the same noise whenever asked."""
    return nature.sensors[channel].counts(course, np.random.default_rng(9))


def shown(rig, channel, value):
    """An SI value in the unit in which sizes are told."""
    return np.rad2deg(value) if rig.dimension_of(rig.channel(channel).senses) == "angle" else value


@pytest.mark.parametrize(("name", "effect", "where", "size"), CASES)
def test_it_changes_its_channel_and_no_other(bare, name, effect, where, size):
    rig, plain, played = bare[name]
    nature = make_nature(rig, 5, [f"{effect}@{where}={size}"], poses=6)
    channel = where.partition("<-")[0]
    for other in nature.sensors:
        before, after = (read(each, played.course, other) for each in (plain, nature))
        assert np.array_equal(before, after) == (other != channel)
    mechanism = {n: v for n, v in plain.truth.parameters.items() if n != f"{channel}.gain"}
    assert {n: nature.truth.parameters[n] for n in mechanism} == mechanism
    assert plain.rig.places == nature.rig.places
    told = nature.truth.effects
    assert [(e.name, e.where) for e in told] == [(effect, where)]
    assert json.dumps([e.size for e in told])


def departure(rig, nature, channel, values):
    """What a channel sees beyond the true ``values`` at rest [deg or m]."""
    values = np.asarray(values)
    every = {c.name: values for c in rig.channels}
    course = sampled_course(np.arange(len(values)) * 0.01, every)
    sensor, seen = nature.sensors[channel], values
    for effect in sensor._effects:
        seen = effect.seen(channel, seen, course)
    return shown(rig, channel, seen - values)


@pytest.mark.parametrize("effect", ["eccentricity", "cyclic-error"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_periodic_error_repeats_and_has_the_size_asked_for(bare, effect, seed):
    rig, *_ = bare["arm"]
    nature = make_nature(rig, seed, [f"{effect}@q4=0.05"])
    at = rests(make_nature(rig, seed)).value["q4"]
    np.testing.assert_allclose(departure(rig, nature, "q4", at).std(), 0.05, rtol=1e-9)
    turn = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    once = departure(rig, nature, "q4", turn)
    np.testing.assert_allclose(departure(rig, nature, "q4", turn + 2 * np.pi), once, atol=1e-9)
    power = np.abs(np.fft.rfft(once))
    first = int(np.argmax(power))
    assert first == 1 if effect == "eccentricity" else first in (2, 3, 4, 6, 8, 12, 16)
    share = 0.1 if effect == "eccentricity" else 0.05
    assert power[2 * first] / power[first] == pytest.approx(share, rel=1e-6)
    rest = np.delete(power, [first, 2 * first])
    assert rest.max() < 1e-6 * power[first]


def test_lengths_that_turn_have_an_eccentricity(bare):
    text, source = rig_text("shoulder")
    rig, *_ = bare["shoulder"]
    assert EFFECT_KINDS["eccentricity"].places(rig) == ()
    text = text.replace('senses = "leg2"', 'senses = "leg2"\nturn_mm = 30')
    rig = parse_rig(text, source)
    assert EFFECT_KINDS["cyclic-error"].places(rig) == ("d2",)
    nature = make_nature(rig, 1, ["eccentricity@d2=1e-4"])
    at = 0.1 + np.linspace(0, 0.03, 40)
    one, two = (departure(rig, nature, "d2", at + shift) for shift in (0.0, 0.03))
    np.testing.assert_allclose(one, two, atol=1e-12)
    assert 0.7e-4 < one.std() < 1.5e-4


def test_backlash_remembers_the_direction_and_hides_reversals_within_the_gap(bare):
    rig, *_ = bare["arm"]
    nature = make_nature(rig, 1, ["backlash@q3=0.2"])
    way = np.concatenate(
        [np.linspace(0, 10, 50), np.linspace(10, 9.85, 20), np.linspace(9.85, 2, 50)]
    )
    gone = departure(rig, nature, "q3", np.deg2rad(way))
    np.testing.assert_allclose(gone[49], -0.1, atol=1e-12)
    # A reversal smaller than the gap: what is seen stands still.
    np.testing.assert_allclose(way[50:70] + gone[50:70], way[49] + gone[49], atol=1e-9)
    np.testing.assert_allclose(gone[-10:], 0.1, atol=1e-12)
    # Asked again from the start, it begins anew; asked on, it remembers.
    np.testing.assert_array_equal(departure(rig, nature, "q3", np.deg2rad(way)), gone)


def test_a_drift_has_the_slope_asked_for_and_may_saturate(bare):
    rig, *_ = bare["arm"]
    curved = []
    for seed in range(8):
        nature = make_nature(rig, seed, ["offset-drift@q5=0.002"], poses=4)
        time_s = rests(make_nature(rig, seed), 4).time_s
        course = sampled_course(time_s, {c.name: np.zeros(len(time_s)) for c in rig.channels})
        (effect,) = nature.sensors["q5"]._effects
        crept = np.rad2deg(effect.seen("q5", np.zeros(len(time_s)), course))
        line = np.polyfit(time_s, crept, 1)
        assert line[0] == pytest.approx(0.002, rel=1e-6)
        curved.append(np.abs(crept - np.polyval(line, time_s)).max() > 1e-6)
    assert 0 < sum(curved) < 8


def test_a_jump_happens_once_amid_the_session(bare):
    rig, *_ = bare["shoulder"]
    end_s = rests(make_nature(rig, 2)).end_s
    nature = make_nature(rig, 2, ["offset-jump@d3=-2e-4"])
    time_s = np.linspace(0, end_s, 4001)
    course = sampled_course(time_s, {c.name: np.zeros(len(time_s)) for c in rig.channels})
    (effect,) = nature.sensors["d3"]._effects
    step = effect.seen("d3", np.zeros(len(time_s)), course)
    assert set(np.unique(step)) == {0.0, -2e-4}
    at = time_s[np.argmax(step < 0)]
    assert 0.25 * end_s <= at <= 0.75 * end_s + 0.1
    assert np.all(np.diff(step) <= 0)


def test_a_lag_trails_at_speed_and_catches_up_at_rest(bare):
    rig, *_ = bare["arm"]
    nature = make_nature(rig, 1, ["lag@q3=0.05"])
    time_s = np.arange(0, 4, 0.01)
    value = 0.4 * np.clip(time_s - 0.5, 0.0, 2.0)
    course = sampled_course(time_s, {c.name: value for c in rig.channels})
    (effect,) = nature.sensors["q3"]._effects
    seen = effect.seen("q3", value, course)
    assert seen[50] == value[50]
    np.testing.assert_allclose((seen - value)[200:250], -0.4 * 0.05, atol=1e-9)
    assert np.abs(seen - value)[-1] < 1e-9
    # Sample by sample, as at a live bench, it is the same filter.
    nature = make_nature(rig, 1, ["lag@q3=0.05"])
    (effect,) = nature.sensors["q3"]._effects
    alone = []
    for k in range(len(time_s)):
        one = {c.name: value[[k]] for c in rig.channels}
        course = type(course)(time_s[[k]], one, one)
        alone.append(effect.seen("q3", value[[k]], course)[0])
    np.testing.assert_allclose(alone, seen, atol=1e-12)


def test_crosstalk_adds_counts_of_its_neighbour(bare):
    rig, plain, played = bare["shoulder"]
    nature = make_nature(rig, 5, ["crosstalk@d2<-d1=5%"], poses=6)
    before, after = (read(each, played.course, "d2") for each in (plain, nature))
    parameters = plain.truth.parameters
    steps = (played.course.value["d1"] - parameters["d1.offset"]) / parameters["d1.gain"]
    np.testing.assert_allclose(
        after - before, 0.05 * steps, atol=1.0 + 0.0005 * np.abs(steps).max()
    )
    assert np.abs(after - before).max() > 10


@pytest.mark.parametrize("seed", range(4))
def test_a_stuck_bit_never_toggles_and_the_others_do(bare, seed):
    rig, plain, played = bare["shoulder"]
    nature = make_nature(rig, seed, ["stuck-bit@d2=1e-4"])
    (told,) = nature.truth.effects
    bit = round(np.log2(told.size / 0.029296875e-3))
    assert told.size == pytest.approx(2**bit * 0.029296875e-3)
    before, after = (read(each, played.course, "d2") for each in (plain, nature))
    assert len(np.unique(after >> bit & 1)) == 1
    mask = ~(1 << bit)
    if seed == 5:
        np.testing.assert_array_equal(after & mask, before & mask)
    assert len(np.unique(after & mask)) > 10


def test_saturation_ends_the_codes_inside_the_travel(bare):
    rig, *_ = bare["shoulder"]
    ends = set()
    for seed in range(8):
        stops = rests(make_nature(rig, seed)).value["d3"]
        nature = make_nature(rig, seed, ["saturation@d3=3e-3"])
        course = sampled_course(np.arange(len(stops)) * 0.1, {c.name: stops for c in rig.channels})
        raw = read(nature, course, "d3")
        values = nature.truth.parameters
        seen = values["d3.gain"] * (raw - 2048) + values["d3.offset"]
        off_high, off_low = stops.max() - seen.max(), seen.min() - stops.min()
        beyond = max(off_high, off_low)
        assert beyond == pytest.approx(3e-3, abs=0.1e-3)
        ends.add(off_high > off_low)
    assert ends == {True, False}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("eccentricity@q3=5%", "expected a number in deg"),
        ("eccentricity@q6=-1", "above 0"),
        ("eccentricity@q3=19", "ask for less"),
        ("backlash@joint3=0.1", "cannot sit at 'joint3'"),
        ("offset-drift@q3=2", "a number in deg/s, at most 1 either way"),
        ("crosstalk@q1<-q2=1%", "cannot sit at 'q1<-q2'.*q6<-q7, q7<-q6"),
        ("crosstalk@q6<-q7=60%", "at most 0.5"),
        ("stuck-bit@q6=0.001", r"bit 0\) to .* \(bit 11\)"),
        ("stuck-bit@q1=1", "cannot sit at 'q1'.*q6, q7"),
        ("saturation@q6=120", "40% of the travel"),
        ("lag@q3=1 s", "size of 'lag' is '1 s'"),
    ],
)
def test_what_cannot_be_is_one_clear_error(arm, text, message):
    with pytest.raises(BadEffect, match=message):
        make_nature(arm, 0, [text], poses=6)
