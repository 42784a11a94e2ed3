"""Which dwells visited one pose: by number where numbers repeat, else by what was read."""

from __future__ import annotations

import numpy as np

from solver.dwells import Window
from solver.gap.floor import same_poses


def windows(*poses: tuple[int, str | None]) -> list[Window]:
    return [Window(0, 1, pose, visit, fixture) for visit, (pose, fixture) in enumerate(poses)]


def test_numbers_count_in_the_order_of_the_recording() -> None:
    seen = windows((5, None), (3, None), (5, None), (4, None))
    assert same_poses(seen, np.zeros((4, 2))).tolist() == [0, 1, 0, 2]


def test_one_number_in_two_fixtures_is_two_poses() -> None:
    seen = windows((1, "a"), (1, "b"), (2, "a"), (1, "a"))
    assert same_poses(seen, np.zeros((4, 2))).tolist() == [0, 1, 2, 0]


def test_poses_by_hand_that_all_differ_in_number_are_told_by_their_readings() -> None:
    counts = np.array([[0.0, 0.0], [100.0, 50.0], [1.0, 0.5], [100.5, 50.0]])
    seen = windows((1, None), (2, None), (3, None), (4, None))
    assert same_poses(seen, counts).tolist() == [0, 1, 0, 1]
