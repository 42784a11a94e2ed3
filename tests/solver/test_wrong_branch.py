"""A model that starts on a wrong branch: the right answer, or a status and a remedy; never a confident wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recordings.rig import PlatformMechanism, SerialMechanism, load_rig, parameters
from solver.estimate.trust_region import Status
from solver.mechanism.space import ParameterSpace
from solver.samples import PoseTable
from solver.solve import solve_table
from tests.solver.synthetic import pose_table, true_parameters


def right_or_refused(name: str, table: PoseTable, seed: int, **changed: object) -> str:
    """Status of a solve of ``table`` with the mechanism changed; its numbers are checked where it converged."""
    rig = load_rig(name)
    mechanism = rig.mechanism.model_copy(update=changed)
    solved = solve_table(rig.model_copy(update={"mechanism": mechanism}), table)
    if solved.estimate.status is Status.CONVERGED:
        space = ParameterSpace.of(parameters(rig))
        true = space.reduce(true_parameters(rig, seed))
        off = np.abs(solved.estimate.values - true) / solved.estimate.standard_errors
        assert off.max() < 5.0
    else:
        bad = [f.text for f in solved.findings if f.grade == "bad"]
        assert len(bad) == 1
        assert len(bad[0].split()) > 10
    return solved.estimate.status.word


@pytest.mark.parametrize("seed", [1, 2])
def test_a_platform_that_starts_upside_down(seed: int) -> None:
    mechanism = load_rig("shoulder").mechanism
    assert isinstance(mechanism, PlatformMechanism)
    turned = mechanism.neutral.model_copy(update={"rx": mechanism.neutral.rx + np.pi})
    right_or_refused("shoulder", pose_table("shoulder", seed=seed), seed, neutral=turned)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_arm_whose_homes_are_mirrored(seed: int) -> None:
    mechanism = load_rig("arm").mechanism
    assert isinstance(mechanism, SerialMechanism)
    joints = tuple(
        joint.model_copy(update={"home": replace(joint.home, nominal=-joint.home.nominal)})
        for joint in mechanism.joints
    )
    word = right_or_refused("arm", pose_table("arm", seed=seed), seed, joints=joints)
    assert word == "converged"
