"""Effects that move geometry or yield under load, against their closed forms; where they can sit."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import DescribedEffect, Quantity, load_rig
from solver.effects.effect import Effect, Site
from solver.effects.link_geometry import twins
from solver.effects.registry import effect_kinds
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

Array = np.ndarray
POSES = 8


def at(places: int) -> Circumstances:
    rng = np.random.default_rng(2)
    return Circumstances(
        time_s=np.arange(POSES) * 2.0,
        torque=rng.normal(0, 5, (POSES, places)),
        force=rng.normal(0, 20, (POSES, 3)),
    )


def described(site: Site, name: str, where: str, **given: tuple[float, str]) -> Effect:
    quantities = {key: Quantity(value, dimension) for key, (value, dimension) in given.items()}
    return effect_kinds()[name].read(site, DescribedEffect(name, where, quantities))


def moved(effect: Effect, *coefficients: float, places: int = 8) -> dict[str, Array]:
    shift = effect.moved(np.array(coefficients), at(places), POSES)
    assert shift is not None
    names = [effect.site.names[t] for t in shift.targets]
    return dict(zip(names, shift.amount.T, strict=True))


def test_a_sensor_on_the_motors_side_is_ahead_by_what_the_spring_yields() -> None:
    site, around = Site(load_rig("arm")), at(8)
    assert around.torque is not None
    effect = described(site, "joint-compliance", "joint5", compliance=(0.0, "angular compliance"))
    shift = effect.seen(np.zeros((POSES, 7)), np.array([1e-4]), around)
    assert shift is not None
    assert shift.targets.tolist() == [4]  # q5
    np.testing.assert_allclose(shift.amount[:, 0], 1e-4 * around.torque[:, 5])


def test_a_leg_under_tension_reads_short() -> None:
    site, around = Site(load_rig("shoulder")), at(4)
    assert around.torque is not None
    effect = described(site, "joint-compliance", "leg3", compliance=(0.0, "compliance"))
    shift = effect.seen(np.zeros((POSES, 4)), np.array([1e-5]), around)
    assert shift is not None
    np.testing.assert_allclose(shift.amount[:, 0], -1e-5 * around.torque[:, 2])


def test_a_fixture_yields_along_the_force_and_slips_at_its_moment() -> None:
    site, around = Site(load_rig("arm")), at(8)
    assert around.force is not None
    soft = moved(
        described(site, "fixture-compliance", "fixture", compliance=(0.0, "compliance")), 1e-5
    )
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(soft[f"mount.{name}"], 1e-5 * around.force[:, axis])
    parts = {
        p: (0.0, "length" if len(p) == 1 else "angle") for p in ("x", "y", "z", "rx", "ry", "rz")
    }
    effect = described(site, "fixture-slip", "fixture", at=(7.0, "time"), **parts)
    slipped = moved(effect, 1e-3, 2e-3, -2e-3, 1e-3, 0.0, 5e-3)
    np.testing.assert_allclose(slipped["mount.x"], [0.0] * 4 + [1e-3] * 4)
    np.testing.assert_allclose(slipped["mount.rz"], [0.0] * 4 + [5e-3] * 4)
    assert effect.size(np.array([1e-3, 2e-3, -2e-3, 0, 0, 0]), np.zeros((1, 7)), around) == (
        pytest.approx(3e-3)
    )
    pivot = Site(load_rig("shoulder"))
    only = effect_kinds()["fixture-slip"](pivot, "fixture", 7.0)  # type: ignore[call-arg]
    assert [c.name for c in only.coefficients] == ["x", "y", "z"]


def test_geometry_moves_what_it_names_and_what_follows_it() -> None:
    site = Site(load_rig("arm"))
    wrong = moved(described(site, "link-geometry", "joint3.s", change=(0.0, "length")), 2e-3)
    assert list(wrong) == ["joint3.s"]
    np.testing.assert_allclose(wrong["joint3.s"], 2e-3)
    apart = moved(described(site, "axis-offset", "joint4", offset=(0.0, "length")), 1e-3)
    assert list(apart) == ["joint4.a"]
    plate = Site(load_rig("shoulder"))
    xyz = dict.fromkeys("xyz", (0.0, "length"))
    beside = moved(described(plate, "axis-offset", "B2", **xyz), 1e-3, 2e-3, 3e-3)
    assert list(beside) == ["leg4.plate.x", "leg4.plate.y", "leg4.plate.z"]
    np.testing.assert_allclose(beside["leg4.plate.z"], 3e-3)


def test_all_lengths_behind_the_base_grow_with_time() -> None:
    site, around = Site(load_rig("arm")), at(8)
    assert around.time_s is not None
    effect = described(site, "thermal-growth", "links", rate=(0.0, "rate"))
    shift = effect.moved(np.array([1e-5]), around, POSES)
    assert shift is not None
    assert shift.relative
    grown = moved(effect, 1e-5)
    assert not any(name.startswith("hinge.") for name in grown)
    for name in ("joint1.s", "joint3.s", "joint5.s", "joint7.a", "joint7.s"):
        np.testing.assert_allclose(grown[name], 1e-5 * around.time_s)
    assert set(grown) == {"joint1.s", "joint3.s", "joint5.s", "joint7.a", "joint7.s"}


def test_lengths_that_only_set_the_scale_together_are_one_place() -> None:
    site = Site(load_rig("arm"))
    found = twins(site)
    assert found["joint3.s"] == ("joint5.s",)
    assert "joint5.s" not in found
    # The zero of an unsensed joint is where that joint is said to stand, and shows nowhere.
    assert "hinge.theta_offset" not in found
    # What is stated to meet is named by axis-offset, what is identified needs no effect.
    assert not any(name in found for name in ("joint2.a", "joint1.s"))
    # A frame that the rig fixes by three points is no place at all.
    assert twins(Site(load_rig("stewart"))) == {}
    # It reads what the rig describes all the same.
    described(site, "link-geometry", "joint5.s", change=(0.0, "length"))
    with pytest.raises(MechanismError, match="held fixed"):
        described(site, "link-geometry", "joint1.s", change=(0.0, "length"))


def test_what_rig_and_session_cannot_tell_is_said_in_words() -> None:
    kinds = effect_kinds()
    rig = load_rig("arm")
    nothing = Circumstances()
    assert "gravity_m_per_s2" in str(
        kinds["joint-compliance"].untestable(
            Site(rig.model_copy(update={"gravity": None})), "joint5", nothing
        )
    )
    assert "which joints were held" in str(
        kinds["fixture-compliance"].untestable(Site(rig), "fixture", nothing)
    )
    still = Circumstances(torque=np.zeros((3, 8)), force=np.zeros((3, 3)), time_s=np.zeros(3))
    assert "no drive held it" in str(
        kinds["joint-compliance"].untestable(Site(rig), "joint5", still)
    )
    assert "one time" in str(kinds["thermal-growth"].untestable(Site(rig), "links", still))
    assert "nothing presses" in str(
        kinds["fixture-compliance"].untestable(Site(rig), "fixture", still)
    )
    pressed = Circumstances(force=np.ones((3, 3)))
    assert kinds["fixture-compliance"].untestable(Site(rig), "fixture", pressed) is None
