"""The stops of a session: how many, in which order, always the same."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial import Delaunay

from recordings.rig import Plan, load_rig, visits

DEGREE = np.pi / 180


def plan(**keys: object) -> Plan:
    table = {"mode": "driven", "drives": ["a", "b"], **keys}
    return Plan.model_validate(table)


SQUARE = [[0, 0], [90, 0], [90, 90], [0, 90]]
ROWS = [[float(i), float(-i)] for i in range(5)]


@pytest.mark.parametrize(
    ("poses", "again", "times"), [(60, 10, 3), (8, 20, 2), (5, 0, 3), (5, 5, 1)]
)
def test_every_pose_is_visited_and_some_again(poses: int, again: int, times: int) -> None:
    stops = visits(plan(corners_deg=SQUARE, poses=poses, revisit={"poses": again, "visits": times}))
    assert [stop.pose for stop in stops[:poses]] == list(range(poses))
    assert {stop.visit for stop in stops[:poses]} == {0}
    counts = Counter(stop.pose for stop in stops)
    revisited = [pose for pose, count in counts.items() if count > 1]
    assert len(revisited) == (min(poses, again) if times > 1 else 0)
    assert all(counts[pose] == times for pose in revisited)
    for pose in revisited:
        own = [stop for stop in stops if stop.pose == pose]
        assert [stop.visit for stop in own] == list(range(times))
        assert {stop.targets for stop in own} == {own[0].targets}


def test_revisits_come_in_random_order_round_by_round() -> None:
    stops = visits(plan(corners_deg=SQUARE, poses=30, revisit={"poses": 10, "visits": 3}))[30:]
    first, second = stops[:10], stops[10:]
    assert {stop.visit for stop in first} == {1}
    assert {stop.visit for stop in second} == {2}
    assert {stop.pose for stop in first} == {stop.pose for stop in second}
    assert [stop.pose for stop in first] != [stop.pose for stop in second]
    assert [stop.pose for stop in first] != sorted(stop.pose for stop in first)


def test_poses_fill_the_region_and_stay_in_it() -> None:
    corners = np.array([[0, 0], [90, 0], [0, 90]])
    stops = visits(plan(corners_deg=corners.tolist(), poses=200, revisit={"poses": 0}))
    points = np.array([stop.targets for stop in stops]) / DEGREE
    assert np.all(Delaunay(corners).find_simplex(points) >= 0)
    assert len(np.unique(points, axis=0)) == 200
    np.testing.assert_allclose(points.mean(axis=0), [30, 30], atol=2)


def test_each_pose_is_followed_by_the_nearest_not_yet_visited() -> None:
    stops = visits(plan(corners_deg=SQUARE, poses=40, revisit={"poses": 0}))
    points = np.array([stop.targets for stop in stops])
    for i in range(len(points) - 1):
        steps = np.linalg.norm(points[i + 1 :] - points[i], axis=1)
        assert steps[0] == steps.min()


def test_one_drive_has_a_line_for_a_region() -> None:
    stops = visits(plan(drives=["a"], corners_deg=[[10], [70]], poses=20, revisit={"poses": 0}))
    points = np.array([stop.targets for stop in stops]) / DEGREE
    assert points.shape == (20, 1)
    assert points.min() >= 10
    assert points.max() <= 70
    assert np.max(np.diff(np.sort(points[:, 0]))) < 12


def test_listed_targets_are_taken_in_their_order() -> None:
    table = plan(targets_deg=ROWS, revisit={"poses": 0})
    assert [stop.targets for stop in visits(table)] == [
        (row[0] * DEGREE, row[1] * DEGREE) for row in ROWS
    ]
    assert len(visits(table, poses=3)) == 3
    assert len(visits(table, poses=99)) == 5


def test_by_hand_the_operator_chooses_where() -> None:
    by_hand = Plan.model_validate({"mode": "by-hand", "poses": 7, "revisit": {"poses": 2}})
    stops = visits(by_hand)
    assert len(stops) == 7 + 2 * 2
    assert {stop.targets for stop in stops} == {()}


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_the_same_plan_gives_the_same_session(name: str) -> None:
    table = load_rig(name).plan
    assert table is not None
    assert visits(table) == visits(table)
    assert len(visits(table)) == table.poses + 10 * 2
    assert len(visits(table, poses=20)) == 20 + 10 * 2
    other = table.model_copy(update={"seed": 2})
    assert [stop.pose for stop in visits(other)] != [stop.pose for stop in visits(table)]
