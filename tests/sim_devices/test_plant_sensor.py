"""Counts of a sensor: scale, noise, range, wrap, and the servo's inverse."""

import numpy as np
import pytest

from recordings.rig import Channel
from sim_devices.plant.effects.effect import Effect
from sim_devices.plant.motion import Course
from sim_devices.plant.sensor import Sensor


def channel(**more):
    return Channel.model_validate(
        {"name": "c", "senses": "j", "gain_rad_per_count": 0.001, "zero_count": 2048, **more}
    )


def sensor(described, gain=0.001, offset=0.0, effects=()):
    return Sensor(described, {"c.gain": gain, "c.offset": offset}, effects)


def still(values):
    values = np.asarray(values, dtype=float)
    return Course(np.arange(len(values)) * 0.01, {"c": values}, {"c": np.zeros(len(values))})


def test_counts_follow_true_gain_and_offset():
    counts = sensor(channel(), gain=0.002, offset=0.1).counts(
        still([0.1, 0.3, -0.1]), np.random.default_rng(0)
    )
    assert counts.tolist() == [2048, 2148, 1948]


def test_noise_has_the_stated_size_and_is_seeded():
    noisy = sensor(channel(noise_counts=3.0))
    course = still(np.full(20000, 0.0003))
    counts = noisy.counts(course, np.random.default_rng(1))
    # Rounding to whole counts adds a variance of 1/12.
    assert counts.std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.02)
    assert counts.mean() == pytest.approx(2048.3, abs=0.08)
    np.testing.assert_array_equal(counts, noisy.counts(course, np.random.default_rng(1)))


def test_an_adc_clips():
    adc = sensor(channel(count_range=[0, 4095]))
    assert adc.counts(still([5.0, -5.0]), np.random.default_rng(0)).tolist() == [4095, 0]
    assert adc.span == pytest.approx((-2.048, 2.047))


def test_a_counter_wraps():
    counter = sensor(channel(count_range=[0, 4095], modulus_counts=4096))
    counts = counter.counts(still([2.047, 2.048, -2.049]), np.random.default_rng(0))
    assert counts.tolist() == [4095, 0, 4095]


@pytest.mark.parametrize("raw", [0, 100, 2048, 4095])
@pytest.mark.parametrize("modulus", [None, 4096])
def test_a_servo_finds_where_its_sensor_reads_the_target(raw, modulus):
    described = channel(count_range=[0, 4095], modulus_counts=modulus)
    bent = Bent("c", 0.1, "deg")
    one = sensor(described, gain=0.0011, offset=0.05, effects=(bent,))
    value = one.value_at(raw)
    assert one.counts(still([value]), np.random.default_rng(0)).tolist() == [raw]


class Bent(Effect):
    """A departure with a slope of up to 0.3."""

    name = "bent"

    @classmethod
    def places(cls, rig):
        return ()

    @classmethod
    def typical(cls, rig, where, rng):
        return "1"

    @classmethod
    def make(cls, request):
        return cls(request.where, 1.0, "deg")

    def at_rest(self, channel, value):
        return value + self.size * np.sin(3 * value) if channel == self.where else value
