"""What interlocks judge: plans, modes, targets, torques and motion, without a session."""

from __future__ import annotations

import numpy as np
import pytest

from daq.interlocks import Interlocks
from daq.mobility import Mobility, counted
from daq.standstill import Window
from recordings.events import Mode
from recordings.rig import Rig, parse_rig, rig_text, visits

STEP_NS = 10_000_000
GAIN = np.deg2rad(0.0009)  # of the arm's encoders
ZERO = 200_000
NOISE = 2.0


def armed_with(interlocks: str, name: str = "arm") -> Rig:
    return parse_rig(f"{rig_text(name)[0]}\n{interlocks}", name)


def judge(rig: Rig) -> Interlocks:
    return Interlocks(rig, counted(rig))


def seen(angle_rad, seed: int = 1) -> tuple[dict[str, Window], dict[str, int]]:
    """Samples of q1 at 100 Hz, with noise, of a joint at ``angle_rad`` (n,)."""
    rng = np.random.default_rng(seed)
    counts = np.rint(np.asarray(angle_rad) / GAIN + NOISE * rng.standard_normal(len(angle_rad)))
    raw = counts.astype(np.int64) + ZERO
    window = Window(np.arange(len(raw)) * STEP_NS, raw - raw[0])
    return {"q1": window}, {"q1": int(raw[-1])}


def test_the_bundled_plan_is_allowed_and_one_joint_more_is_not() -> None:
    rig = armed_with("")
    assert judge(rig).of_plan(rig.plan, visits(rig.plan)) == ()
    drives = (*rig.plan.drives, next(j for j in ("joint1", "joint2") if j not in rig.plan.drives))
    plan = rig.plan.model_copy(update={"drives": drives, "corners": None, "targets": ((0.0,) * 3,)})
    (text,) = judge(rig).of_plan(plan, visits(plan.model_copy(update={"targets": ((0.3,) * 3,)})))
    assert "3 joints in position mode" in text
    assert "mobility 2" in text


def test_joints_count_as_held_until_they_are_known_not_to_be() -> None:
    judged = judge(armed_with(""))
    held = {"joint1": Mode.POSITION, "joint2": Mode.POSITION, "joint3": Mode.FREE}
    assert "over-constrain" in judged.of_mode("joint3", Mode.POSITION, held)
    assert judged.of_mode("joint2", Mode.POSITION, held) == ""
    assert judged.of_mode("joint3", Mode.FREE, held) == ""
    assert judged.of_mode("joint3", Mode.OFF, dict.fromkeys(held, Mode.POSITION)) == ""


def test_joints_that_only_move_together_are_not_held_together() -> None:
    motions = np.zeros((4, 3, 2))
    motions[:, 0, 0] = motions[:, 1, 0] = np.sqrt(0.5)  # a and b move as one
    motions[:, 2, 1] = 1.0
    mobility = Mobility(2, ("a", "b", "c"), motions)
    assert "a, b cannot move independently" in mobility.fights({"a", "b"})
    assert mobility.fights({"a", "c"}) == ""
    assert "mobility 2" in mobility.fights({"a", "b", "c"})


@pytest.mark.parametrize(
    ("name", "freedoms"), [("arm", 2), ("shoulder", 3), ("stewart", 6), ("hangprinter", 3)]
)
def test_freedoms_are_counted(name: str, freedoms: int) -> None:
    assert counted(armed_with("", name)).freedoms == freedoms


def test_modes_that_a_joint_may_not_have_or_not_together() -> None:
    judged = judge(
        armed_with(
            """
[interlocks]
joint = [{ name = "joint1", modes = ["off", "free"] }]
together = [{ joints = ["joint2", "joint3", "joint4"], mode = "free", at_most = 2 }]
"""
        )
    )
    assert "joint1 must not be in mode 'position'" in judged.of_mode("joint1", Mode.POSITION, {})
    assert "mode 'torque'" in judged.of_mode("joint2", Mode.TORQUE, {})
    free = {"joint2": Mode.FREE, "joint3": Mode.FREE}
    assert "allow 2 of joint2, joint3, joint4" in judged.of_mode("joint4", Mode.FREE, free)
    assert judged.of_mode("joint3", Mode.FREE, free) == ""
    assert judged.of_mode("joint5", Mode.FREE, free) == ""


def test_a_torque_needs_a_limit_and_stays_below_it() -> None:
    judged = judge(
        armed_with(
            '[interlocks]\njoint = [{ name = "joint1", modes = ["torque"], torque_percent = 20 }]\n'
        )
    )
    assert judged.of_mode("joint1", Mode.TORQUE, {}) == ""
    assert judged.of_torque("joint1", -200) == ""
    assert "its limit is 20 %" in judged.of_torque("joint1", 201)
    assert "its limit is 0 %" in judged.of_torque("joint2", 1)


def test_targets_stay_within_travel_and_do_not_jump() -> None:
    judged = judge(
        armed_with(
            '[interlocks]\njoint = [{ name = "joint1", travel_deg = [-10, 60], speed_deg_per_s = 30 }]\n'
        )
    )
    at = np.deg2rad
    assert judged.of_target("joint1", at(59), at(57), 0.1) == ""
    assert "outside its travel" in judged.of_target("joint1", at(61), at(59), 0.1)
    assert "would be led by" in judged.of_target("joint1", at(30), at(20), 0.1)
    # However long it has stood, it does not jump.
    assert "would be led by" in judged.of_target("joint1", at(30), at(10), 60.0)
    assert judged.of_target("joint2", at(30), at(10), 0.1) == ""
    assert "outside its travel" in judged.of_target("joint2", at(171), at(170), 1.0)


def test_a_plan_is_held_against_travel_and_speed() -> None:
    rig = armed_with("")
    first = rig.plan.drives[0]
    rig = armed_with(
        f'[interlocks]\njoint = [{{ name = "{first}", travel_deg = [-1, 1], speed_deg_per_s = 1 }}]\n'
    )
    found = judge(rig).of_plan(rig.plan, visits(rig.plan))
    assert any(first in text and "limit is" in text for text in found)
    assert sum("outside its travel" in text for text in found) > 10


LIMITS = (
    '[interlocks]\njoint = [{ name = "joint1", travel_deg = [-10, 60], speed_deg_per_s = 30 }]\n'
)
TIME_S = np.arange(25) * STEP_NS * 1e-9


@pytest.mark.parametrize(
    ("angle_deg", "said"),
    [
        (0.0 * TIME_S, ""),
        (29.0 * TIME_S, ""),
        (40.0 * TIME_S, "moves with"),
        (-40.0 * TIME_S + 20.0, "moves with"),
        (61.0 + 0.0 * TIME_S, "outside its travel"),
        (-11.0 + 0.0 * TIME_S, "outside its travel"),
    ],
)
def test_motion_outside_the_limits_is_seen(angle_deg, said: str) -> None:
    found = judge(armed_with(LIMITS)).of_motion(*seen(np.deg2rad(angle_deg)))
    assert ("joint1" in found) == bool(said)
    assert said in found.get("joint1", "")


def test_noise_at_a_limit_and_single_wild_readings_are_no_violation() -> None:
    judged = judge(armed_with(LIMITS))
    alarms = 0
    for seed in range(300):
        alarms += bool(judged.of_motion(*seen(np.deg2rad(60.0 + 0.0 * TIME_S), seed)))
        alarms += bool(judged.of_motion(*seen(np.deg2rad(30.0 * TIME_S), seed)))
        angle = np.deg2rad(20.0 + 0.0 * TIME_S)
        angle[seed % len(angle)] = np.deg2rad(80.0)
        alarms += bool(judged.of_motion(*seen(angle, seed)))
    assert alarms == 0


def test_the_joints_limits_are_its_travel_where_no_other_is_given() -> None:
    found = judge(armed_with("")).of_motion(*seen(np.deg2rad(171.0 + 0.0 * TIME_S)))
    assert "outside its travel" in found["joint1"]
