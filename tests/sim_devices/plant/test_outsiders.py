"""Effects outside the catalogue: hidden by name only, of the size told, and not describable."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.effects.registry import EFFECT_KINDS, OUTSIDER_KINDS
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.motion import sampled_course
from sim_devices.plant.session import play, rests

CASES = [
    ("arm", "creep", "q3", "1%"),
    ("arm", "swinging-offset", "q3", "0.1"),
    ("arm", "product-error", "q7<-q6", "0.2"),
    ("arm", "wobbling-axis", "joint3", "0.2"),
    ("shoulder", "creep", "d2", "0.5%"),
    ("shoulder", "swinging-offset", "d2", "1e-4"),
    ("shoulder", "product-error", "d2<-d3", "1e-4"),
    ("shoulder", "bending-leg", "leg2", "1e-4"),
]


def rig_of(name):
    text, source = rig_text(name)
    return parse_rig(text, source)


@pytest.mark.parametrize(("name", "outsider", "where", "size"), CASES)
def test_it_shows_and_is_told_as_an_outsider(name, outsider, where, size):
    rig = rig_of(name)
    plain = play(make_nature(rig, 2), 4)
    nature = make_nature(rig, 2, [f"outsider:{outsider}@{where}={size}"], poses=4)
    (told,) = nature.truth.effects
    assert told.name == f"outsider:{outsider}"
    assert told.where == where
    played = play(nature, 4)
    off = {
        channel: sensor.counts(played.course, np.random.default_rng(0))
        - make_nature(rig, 2).sensors[channel].counts(plain.course, np.random.default_rng(0))
        for channel, sensor in nature.sensors.items()
    }
    changed = {channel for channel, difference in off.items() if np.abs(difference).max() > 2}
    if outsider == "wobbling-axis":
        assert len(changed) > 3
    else:
        place = next(
            c.name for c in rig.channels if where in (c.senses, c.name, f"{c.name}{where[2:]}")
        )
        assert changed == {place}


@pytest.mark.parametrize(
    ("name", "outsider", "where", "size"),
    [case for case in CASES if case[1] in ("swinging-offset", "product-error", "bending-leg")],
)
def test_its_size_is_the_rms_over_the_stops(name, outsider, where, size):
    rig = rig_of(name)
    bare = make_nature(rig, 2)
    stops = rests(bare)
    nature = make_nature(rig, 2, [f"outsider:{outsider}@{where}={size}"])
    (told,) = nature.truth.effects
    if outsider == "bending-leg":
        turned, shifted = stops.coordinates[:, :4], stops.coordinates[:, 4:]
        lengths = nature.mechanism.lengths(turned, shifted, stops.time_s)
        departure = (lengths - bare.mechanism.lengths(turned, shifted, stops.time_s))[:, 1]
    else:
        channel = where.partition("<-")[0]
        course = sampled_course(stops.time_s, stops.value)
        (effect,) = nature.sensors[channel]._effects
        departure = effect.seen(channel, stops.value[channel], course) - stops.value[channel]
    to_si = np.pi / 180 if told.unit == "deg" else 1.0
    assert told.size == float(size)
    assert np.std(departure) / to_si == pytest.approx(told.size, rel=1e-3)


def test_a_creep_fades_at_rest():
    nature = make_nature(rig_of("arm"), 2, ["outsider:creep@q3=1%"])
    (effect,) = nature.sensors["q3"]._effects
    time_s = np.arange(0.0, 60.0, 0.01)
    value = np.clip(time_s - 1.0, 0.0, 1.0)
    course = sampled_course(time_s, dict.fromkeys(nature.sensors, value))
    off = effect.seen("q3", value, course) - value
    assert off[200] == pytest.approx(-0.01, abs=0.0015)
    assert np.all(np.diff(off[205:]) > 0)
    assert abs(off[-1]) < 1e-3


def test_chance_never_brings_outsiders_and_rigs_do_not_describe_them(describing):
    assert not set(OUTSIDER_KINDS) & set(EFFECT_KINDS)
    assert all(name.startswith("outsider:") for name in OUTSIDER_KINDS)
    rig = describing("arm", "outsider:creep", "q3", ratio=0.01)
    with pytest.raises(BadEffect, match="nature knows no effect 'outsider:creep'"):
        make_nature(rig, 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("outsider:ghost@q3=1", "no effect 'outsider:ghost'; expected one of: outsider:creep"),
        ("outsider:bending-leg@q3=1", "no such place"),
        ("outsider:product-error@q7<-q6=15", "ask for less"),
        ("outsider:creep@q3=80%", "at most 0.5"),
    ],
)
def test_a_bad_wish_is_one_clear_error(arm, text, message):
    with pytest.raises(BadEffect, match=message):
        make_nature(arm, 0, [text], poses=4)
