"""What warms up: its course, where it begins and ends, and how big it is said to be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from recordings.rig import DescribedEffect, Quantity, load_rig
from solver.effects.effect import Effect, Recorded, Site
from solver.effects.offset_drift import OffsetDrift
from solver.effects.registry import effect_kinds
from solver.effects.thermal_growth import ThermalGrowth
from solver.effects.warm_up import course
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

Array = np.ndarray
TIME_S = np.linspace(2.0, 300.0, 41)


def moved(effect: OffsetDrift | ThermalGrowth, at: Circumstances, *coefficients: float) -> Array:
    found = effect.moved_by(np.array(coefficients), at)
    assert found is not None
    return found[0]


def warming(**given: tuple[float, str]) -> Effect:
    values = {key: Quantity(*value) for key, value in given.items()}
    described = DescribedEffect("offset-drift", "q6", values)
    return effect_kinds()["offset-drift"].read(Site(load_rig("arm")), described)


@pytest.mark.parametrize("decay", [0.0, 1e-9, 1e-5, 3.3e-5, 3.4e-5, 1e-3, 0.03, 2.0, -1e-5, -4e-3])
def test_the_course_is_the_integral_of_a_fading_speed(decay: float) -> None:
    crept, by_decay = course(TIME_S, decay)
    for time_s, c, by in zip(TIME_S[::8], crept[::8], by_decay[::8], strict=True):
        exact = quad(lambda s: np.exp(-decay * s), 0.0, time_s, epsabs=0.0, epsrel=1e-12)[0]
        slope = quad(lambda s: -s * np.exp(-decay * s), 0.0, time_s, epsabs=0.0, epsrel=1e-12)[0]
        assert c == pytest.approx(exact, rel=1e-11)
        assert by == pytest.approx(slope, rel=1e-10)


def test_without_decay_it_is_a_straight_line_and_with_much_it_ends() -> None:
    np.testing.assert_array_equal(course(TIME_S, 0.0)[0], TIME_S)
    np.testing.assert_allclose(course(TIME_S, 5.0)[0], 0.2, rtol=1e-4)
    assert np.isfinite(course(TIME_S, -1e9)[0]).all()


def test_a_machine_that_is_half_warm_already_has_the_same_decay() -> None:
    site, at = Site(load_rig("arm")), Circumstances(time_s=TIME_S)
    cold = moved(OffsetDrift(site, "q6", 0.01), replaced_by(at, 100.0), 2e-5, 0.01)
    warm = moved(OffsetDrift(site, "q6", 0.01), at, 2e-5 * np.exp(-1.0), 0.01)
    np.testing.assert_allclose(np.diff(cold), np.diff(warm), rtol=1e-9)


def replaced_by(at: Circumstances, later_s: float) -> Circumstances:
    assert at.time_s is not None
    return Circumstances(time_s=at.time_s + later_s)


def test_every_session_begins_cold() -> None:
    site = Site(load_rig("shoulder"))
    begun = np.repeat([0.0, 400.0], len(TIME_S))
    at = Circumstances(time_s=np.tile(TIME_S, 2) + begun, begun_s=begun)
    for effect in (OffsetDrift(site, "d1", 0.02), ThermalGrowth(site, "links", 0.02)):
        first, second = np.split(moved(effect, at, 1e-6, 0.02), 2)
        np.testing.assert_allclose(first, second, rtol=1e-12)
        np.testing.assert_allclose(first, 5e-5 * -np.expm1(-0.02 * TIME_S), rtol=1e-12)
        # Decays are tried by how long one session lasts, not all of them.
        forms = effect.variants(site, effect.where, Recorded(np.zeros((len(begun), 4)), at))
        tried = [form.coefficients[1].start * TIME_S[-1] for form in forms[1:]]
        np.testing.assert_allclose(tried, [1.0, 2.0, 4.0, 8.0, 16.0])


def test_its_size_is_the_slope_of_the_best_straight_line() -> None:
    site, at = Site(load_rig("shoulder")), Circumstances(time_s=TIME_S)
    nothing = np.zeros((len(TIME_S), 4))
    for kind, where in ((OffsetDrift, "d1"), (ThermalGrowth, "links")):
        line = kind(site, where).size(np.array([3e-6]), nothing, at)
        assert line == pytest.approx(3e-6, rel=1e-12)
        bent = kind(site, where, 0.01)
        shape = moved(bent, at, 3e-6, 0.01)
        slope = np.polynomial.Polynomial.fit(TIME_S, shape, 1).convert().coef[1]
        assert bent.size(np.array([3e-6, 0.01]), nothing, at) == pytest.approx(slope, rel=1e-9)


def test_a_rig_file_says_by_its_keys_whether_a_drift_fades() -> None:
    rate = (1e-4, "angular speed")
    assert [c.name for c in warming(rate=rate).coefficients] == ["rate"]
    fading = warming(rate=rate, decay=(0.004, "rate"))
    assert [(c.name, c.start) for c in fading.coefficients] == [("rate", 0.0), ("decay", 0.004)]
    with pytest.raises(MechanismError, match="decay"):
        warming(decay=(0.004, "rate"))
    with pytest.raises(MechanismError, match=r"'decay' \(time\)"):
        warming(rate=rate, decay=(250.0, "time"))


def test_what_comes_to_rest_early_may_begin_fast() -> None:
    # By plausible rates, half a session of mean speed: the same way, whatever the decay.
    site, at = Site(load_rig("arm")), Circumstances(time_s=TIME_S)
    forms = OffsetDrift.variants(site, "q6", Recorded(np.zeros((len(TIME_S), 7)), at))
    ways = []
    for form in forms:
        rate, *decay = form.coefficients
        start = [rate.plausible, *(c.start for c in decay)]
        ways.append(float(moved(form, at, *start)[-1]))
    np.testing.assert_allclose(ways, 1e-5 * TIME_S[-1], rtol=1e-9)
