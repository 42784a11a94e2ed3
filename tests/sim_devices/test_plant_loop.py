"""Finding, following and closing configurations of a loop."""

import numpy as np
import pytest

from recordings.rig import parse_rig
from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import MechanismDoesNotClose

NOW = np.zeros(1)


def open_by(loop, variables):
    return np.abs(loop.closure(variables[None], NOW)[0]).max()


@pytest.mark.parametrize("seed", range(5))
def test_assembles_near_home_whatever_the_truth(arm, seed):
    loop = make_nature(arm, seed).mechanism
    here = loop.assemble(np.random.default_rng(0))
    home = np.array([joint.home.nominal for joint in arm.mechanism.joints])
    assert open_by(loop, here) < 1e-10
    assert np.abs(here - home).max() < np.deg2rad(40)
    assert loop.within_limits(here)


def test_without_homes_it_finds_the_configuration_nearest_to_zero(four_bar):
    loop = make_nature(four_bar, 0).mechanism
    found = [loop.assemble(np.random.default_rng(seed)) for seed in range(3)]
    assert all(open_by(loop, here) < 1e-10 for here in found)
    # A crank and rocker has two branches, each a whole turn: near zero there is plenty.
    assert all(np.linalg.norm(here) < 5.0 for here in found)


def test_a_loop_that_cannot_close_is_an_error(four_bar_text):
    rig = parse_rig(four_bar_text.replace("a_m = 0.25", "a_m = 2.5"))
    with pytest.raises(MechanismDoesNotClose, match=r"does not close.*link lengths"):
        make_nature(rig, 0).mechanism.assemble(np.random.default_rng(0))


def test_two_drives_fix_the_pose_and_a_third_can_only_follow(arm):
    loop = make_nature(arm, 1).mechanism
    here = loop.assemble(np.random.default_rng(0))
    assert loop.leaders(here, 0.0, [5, 6]) == [5, 6]
    assert loop.leaders(here, 0.0, [5, 6, 1]) == [5, 6]
    assert loop.leaders(here, 0.0, [1, 5, 6]) == [1, 5]


def test_redundant_closure_rows_do_no_harm(four_bar):
    loop = make_nature(four_bar, 0).mechanism
    here = loop.assemble(np.random.default_rng(0))
    assert loop.leaders(here, 0.0, [0, 1]) == [0]
    passed, shares = loop.follow(here, [0], np.array([here[0] + 1.0]), 0.0)
    there = passed[-1]
    assert shares[-1] == 1.0
    closed, left = loop.polish(there[None], np.array([True, False, False, False]), NOW)
    assert left[0] < 1e-10
    assert closed[0, 0] == here[0] + 1.0


def test_a_step_there_and_back_comes_back(arm):
    loop = make_nature(arm, 2).mechanism
    here = loop.assemble(np.random.default_rng(0))
    target = here[[5, 6]] + np.array([0.2, -0.3])
    passed, shares = loop.follow(here, [5, 6], target, 0.0)
    there = passed[-1]
    assert shares[-1] == 1.0
    np.testing.assert_allclose(there[[5, 6]], target, atol=1e-14)
    back, _ = loop.follow(there, [5, 6], here[[5, 6]], 0.0)
    np.testing.assert_allclose(back[-1], here, atol=1e-4)


def test_a_step_beyond_a_limit_blocks_on_the_way(arm):
    loop = make_nature(arm, 0).mechanism
    here = loop.assemble(np.random.default_rng(0))
    target = here[[5, 6]] + np.array([-4.0, 0.0])
    passed, shares = loop.follow(here, [5, 6], target, 0.0)
    there = passed[-1]
    assert 0.0 < shares[-1] < 1.0
    assert loop.within_limits(there)
    assert open_by(loop, there) < 1e-4


def test_with_one_drive_the_rest_moves_least(arm):
    loop = make_nature(arm, 0).mechanism
    here = loop.assemble(np.random.default_rng(0))
    passed, _ = loop.follow(here, [5], np.array([here[5] + 0.01]), 0.0)
    there = passed[-1]
    _, rate = loop.closure(here[None], NOW)
    _, _, right = np.linalg.svd(rate[0])
    freedoms = right[6:]
    # Of the motions that close the loop and turn the driven joint so far, the smallest.
    freedom = freedoms.T @ freedoms[:, 5]
    held = np.delete(there - here, 5)
    smallest = freedom / freedom[5] * 0.01
    assert np.linalg.norm(held) <= np.linalg.norm(np.delete(smallest, 5)) * 1.01
