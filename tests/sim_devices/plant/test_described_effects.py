"""Effects that a rig describes: played as the formulas of docs/formats.md say, or refused clearly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import legendre

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.registry import EFFECT_KINDS
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import Course
from sim_devices.plant.session import play

NOTHING = {
    "arm": [
        ("gain-error", "q3", {"ratio": 0}),
        ("nonlinearity", "q7", {"p2_deg": 0, "p3_deg": 0, "low_deg": -90, "high_deg": 90}),
        ("eccentricity", "q3", {"cos_deg": 0, "sin_deg": 0}),
        ("cyclic-error", "q2", {"cos_deg": 0, "harmonic": 8}),
        ("backlash", "q7", {"gap_deg": 0}),
        ("offset-drift", "q4", {"rate_deg_per_s": 0}),
        ("offset-drift", "q4", {"rate_deg_per_s": 0, "decay_per_s": 0.01}),
        ("offset-jump", "q1", {"step_deg": 0, "at_s": 5}),
        ("lag", "q3", {"delay_s": 0}),
        ("crosstalk", "q7<-q6", {"ratio": 0}),
        ("saturation", "q7", {"low_counts": 0, "high_counts": 4095}),
        ("joint-compliance", "joint5", {"compliance_deg_per_Nm": 0}),
        ("bearing-compliance", "joint4", {"compliance_deg_per_Nm": 0}),
        ("fixture-compliance", "fixture", {"compliance_m_per_N": 0}),
        ("fixture-slip", "fixture", {"x_m": 0, "rz_deg": 0, "at_s": 5}),
        ("link-geometry", "joint3.s", {"change_m": 0}),
        ("axis-offset", "joint2", {"offset_m": 0}),
        ("thermal-growth", "links", {"rate_per_s": 0, "decay_per_s": 0.01}),
    ],
    "shoulder": [
        ("nonlinearity", "d2", {"p2_m": 0, "low_m": 0.05, "high_m": 0.15}),
        ("backlash", "d1", {"gap_m": 0}),
        ("lag", "d3", {"delay_s": 0}),
        ("crosstalk", "d2<-d1", {"ratio": 0}),
        ("joint-compliance", "leg2", {"compliance_m_per_N": 0}),
        ("fixture-compliance", "fixture", {"compliance_m_per_N": 0}),
        ("fixture-slip", "fixture", {"x_m": 0, "at_s": 5}),
        ("link-geometry", "B1.z", {"change_m": 0}),
        ("axis-offset", "B1", {"x_m": 0}),
        ("thermal-growth", "links", {"rate_per_s": 0}),
    ],
}


def counts(nature, poses):
    played = play(nature, poses)
    return {
        name: sensor.counts(played.course, np.random.default_rng(3))
        for name, sensor in nature.sensors.items()
    }


@pytest.fixture(scope="module")
def bare_counts():
    out = {}
    for name in NOTHING:
        text, source = rig_text(name)
        out[name] = counts(make_nature(parse_rig(text, source), 6), 2)
    return out


@pytest.mark.parametrize(
    ("name", "effect", "where", "values"),
    [(name, *case) for name, cases in NOTHING.items() for case in cases],
)
def test_of_no_size_it_changes_no_bit(describing, bare_counts, name, effect, where, values):
    rig = describing(name, effect, where, **values)
    read = counts(make_nature(rig, 6), 2)
    for channel, before in bare_counts[name].items():
        np.testing.assert_array_equal(read[channel], before)


def test_all_but_stuck_bits_can_be_nothing():
    covered = {case[0] for cases in NOTHING.values() for case in cases}
    assert covered == set(EFFECT_KINDS) - {"stuck-bit"}


TIME_S = np.arange(0.0, 30.0, 0.01)
VALUE = 0.9 * np.sin(0.7 * TIME_S) + 0.1
RATE = 0.63 * np.cos(0.7 * TIME_S)


def seen(rig, channel, gain=1.0):
    """What the described effects of a rig make of VALUE at ``channel``, through steps of ``gain``."""
    nature = make_nature(rig, 1)
    course = Course(
        TIME_S,
        {c.name: VALUE if c.name == channel else 0.5 * VALUE for c in rig.channels},
        dict.fromkeys(nature.sensors, RATE),
    )
    out = VALUE
    for effect in nature.sensors[channel]._effects:
        out = effect.seen(channel, out, course)
    return out


DEG = np.pi / 180
FORMULAS = [
    (
        "nonlinearity",
        {
            "p1_deg": 0.4,
            "p2_deg": 0.3,
            "p3_deg": -0.2,
            "p7_deg": 0.1,
            "low_deg": -80,
            "high_deg": 70,
        },
        DEG * legendre.legval((2 * VALUE / DEG + 80 - 70) / 150, [0, 0.4, 0.3, -0.2, 0, 0, 0, 0.1]),
    ),
    (
        "eccentricity",
        {"cos_deg": 0.3, "sin_deg": -0.2},
        DEG * (0.3 * np.cos(VALUE) - 0.2 * np.sin(VALUE)),
    ),
    (
        "cyclic-error",
        {"cos_rad": 0.003, "sin_rad": 0.002, "harmonic": 5},
        0.003 * np.cos(5 * VALUE) + 0.002 * np.sin(5 * VALUE),
    ),
    ("offset-drift", {"rate_deg_per_s": 0.01}, 0.01 * DEG * TIME_S),
    (
        "offset-drift",
        {"rate_deg_per_s": 0.01, "decay_per_s": 0.125},
        0.08 * DEG * (1 - np.exp(-TIME_S / 8.0)),
    ),
    ("offset-jump", {"step_deg": -0.2, "at_s": 12.0}, -0.2 * DEG * (TIME_S >= 12.0)),
    ("lag", {"delay_s": 0.03}, -0.03 * RATE),
]


@pytest.mark.parametrize(("effect", "values", "delta"), FORMULAS)
def test_a_channel_sees_what_the_formula_says(describing, effect, values, delta):
    rig = describing("arm", effect, "q3", **values)
    np.testing.assert_allclose(seen(rig, "q3") - VALUE, delta, atol=1e-13)
    np.testing.assert_array_equal(seen(rig, "q4"), VALUE)


def test_backlash_after_moves_up_and_down_is_half_a_gap(describing):
    delta = seen(describing("arm", "backlash", "q3", gap_deg=0.2), "q3") - VALUE
    moving = np.abs(RATE) > 0.1
    turned = np.minimum.accumulate(np.abs(np.sign(RATE)))  # never 0 here: rests nowhere
    assert turned.min() == 1.0
    settled = moving & (np.abs(delta) > 0.0999 * DEG)
    assert settled.sum() > 0.95 * moving.sum()
    np.testing.assert_allclose(delta[settled], -0.1 * DEG * np.sign(RATE[settled]), atol=1e-9)


def test_crosstalk_gain_and_a_stuck_bit_act_on_counts(describing, arm):
    course = Course(
        TIME_S,
        {c.name: VALUE if c.name == "q6" else -0.5 * VALUE for c in arm.channels},
        {c.name: RATE for c in arm.channels},
    )

    def steps(rig):
        sensor = make_nature(rig, 1).sensors["q6"]
        return sensor.counts(course, np.random.default_rng(0), np.zeros(len(TIME_S))) - 2048

    count = 0.0439453125 * DEG
    np.testing.assert_array_equal(steps(arm), np.rint(VALUE / count))
    crossed = steps(describing("arm", "crosstalk", "q6<-q7", ratio=0.02))
    np.testing.assert_array_equal(crossed, np.rint(VALUE / count - 0.02 * 0.5 * VALUE / count))
    scaled = steps(describing("arm", "gain-error", "q6", ratio=0.02))
    np.testing.assert_array_equal(scaled, np.rint(VALUE / (1.02 * count)))
    for value, expected in ((0, steps(arm) + 2048 & ~8), (1, steps(arm) + 2048 | 8)):
        stuck = steps(describing("arm", "stuck-bit", "q6", bit=3, value=value))
        np.testing.assert_array_equal(stuck + 2048, expected)
    clipped = steps(describing("arm", "saturation", "q6", high_counts=2500))
    np.testing.assert_array_equal(clipped, np.minimum(steps(arm), 452))


def test_uncertain_coefficients_are_drawn_and_told_as_parameters(describing):
    uncertain = "{ nominal = 0.2, uncertainty = 0.05, identify = true }"
    rig = describing("arm", "eccentricity", "q3", cos_deg=uncertain, sin_deg=0.1)
    drawn = [make_nature(rig, seed).truth for seed in range(40)]
    cosines = np.rad2deg([truth.parameters["eccentricity@q3.cos"] for truth in drawn])
    assert abs(cosines.mean() - 0.2) < 0.03
    assert 0.03 < cosines.std() < 0.07
    assert all(t.parameters["eccentricity@q3.sin"] == pytest.approx(0.1 * DEG) for t in drawn)
    assert drawn[0].effects == ()
    nature = make_nature(rig, 3)
    delta = seen(rig, "q3") - VALUE
    true = make_nature(rig, 1).truth.parameters["eccentricity@q3.cos"]
    np.testing.assert_allclose(delta, true * np.cos(VALUE) + 0.1 * DEG * np.sin(VALUE), atol=1e-13)
    assert nature.truth.units["eccentricity@q3.cos"][0] == "deg"


def test_a_described_geometry_is_not_told_twice(describing):
    rig = describing("arm", "link-geometry", "joint3.s", change_mm=2.0)
    nature = make_nature(rig, 1)
    told = nature.truth.parameters
    assert told["joint3.s"] == 0.355
    assert told["link-geometry@joint3.s.change"] == 0.002
    assert nature.mechanism.geometry(np.zeros((1, 8)), np.zeros(1)).s[3] == pytest.approx(0.357)


@pytest.mark.parametrize(
    ("effect", "where", "values", "message"),
    [
        (
            "bendiness",
            "q3",
            {"ratio": 1},
            "knows no effect 'bendiness'; expected one of: gain-error",
        ),
        ("gain-error", "q3", {"gain": 1}, r"the value 'gain', expected: ratio \(ratio\)"),
        ("gain-error", "q3", {}, "none of its coefficients: ratio"),
        ("gain-error", "q9", {"ratio": 1}, "cannot sit at 'q9'; expected one of: q1, q2"),
        ("backlash", "q3", {"gap_m": 1e-3}, "'gap' of .* is given as length, expected angle"),
        ("backlash", "q3", {"gap_deg": -1}, "expected 0 or above"),
        ("offset-jump", "q3", {"step_deg": 1}, "has no 'at'"),
        ("cyclic-error", "q3", {"cos_deg": 1, "harmonic": 0}, "not above 0"),
        ("stuck-bit", "q6", {"bit": 3, "value": 2}, "the value 0 or 1"),
        ("stuck-bit", "q6", {"bit": 1.5, "value": 1}, "expected a bit from 0"),
        ("saturation", "q6", {"low_counts": 5, "high_counts": 1}, "not above 'low_counts'"),
        ("axis-offset", "joint7", {"offset_m": 1e-3}, "cannot sit at 'joint7'"),
        ("nonlinearity", "q3", {"p2_deg": 1, "low_deg": 2, "high_deg": 1}, "not above 'low'"),
        ("fixture-slip", "hinge", {"x_m": 1e-3, "at_s": 1}, "cannot sit at 'hinge'"),
    ],
)
def test_what_nature_cannot_play_is_one_clear_error(describing, effect, where, values, message):
    rig = describing("arm", effect, where, **values)
    with pytest.raises(BadEffect, match=message):
        make_nature(rig, 0)
