"""Drives are found where few will do, and a plan says which joints will stand still."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import MechanismError
from solver.poses.planning import plan_session
from solver.poses.reach import _convex_part
from tests.solver.test_immobile_joints import anthropomorphic
from tests.solver.test_unsensed_joints import without


def test_an_arm_without_sensors_in_its_wrist_has_one_pair_of_drives() -> None:
    """Home is at the edge of what joints 2 and 5 reach; no other pair holds the rest firmly there."""
    rig, _ = without(6, 7)
    planned = plan_session(rig, poses=30)
    assert planned.plan.drives == ("joint2", "joint5")
    assert planned.plan.poses == 30
    assert planned.still == ()
    assert planned.predicted is not None
    worst = planned.space.names[planned.predicted.worst]
    # What no pose shows no number of poses improves.
    assert worst not in ("joint6.theta_offset", "joint7.theta_offset")
    table = planned.space.table
    bound = np.array([table[i].uncertainty or np.inf for i in planned.space.identified])
    told = [planned.space.names.index(f"joint{k}.theta_offset") for k in (1, 2, 3, 4, 5)]
    assert (planned.predicted.errors[told] < 0.01 * bound[told]).all()


def test_the_elbow_stands_still_in_the_plan_too() -> None:
    planned = plan_session(anthropomorphic(known=True), poses=10)
    (said,) = planned.still
    assert said.startswith("joint4 cannot move while the endpoint is held")


def test_no_drives_are_found_for_what_cannot_move() -> None:
    with pytest.raises(MechanismError, match="mobility 0"):
        plan_session(anthropomorphic(known=True, joints=6))


def grid(width: int, height: int, home: tuple[int, int]) -> np.ndarray:
    nodes = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    nodes = nodes - np.array(home)
    return nodes[np.argsort(np.abs(nodes).sum(axis=1), kind="stable")]


@pytest.mark.parametrize(("home", "kept"), [((3, 3), 25), ((0, 3), 26)])
def test_home_may_lie_on_the_edge_of_the_region(home: tuple[int, int], kept: int) -> None:
    """All but the border is kept, and home, where the straight ways to it are."""
    nodes = grid(7, 7, home)
    inside = _convex_part(nodes)
    assert inside[0] == 0
    assert 9 < len(inside) <= kept
    assert len(nodes[inside]) == len({tuple(n) for n in nodes[inside]})
