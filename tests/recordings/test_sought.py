"""Which coordinates of a fixture a rig from a URDF seeks: those that its freedoms do not undo."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parameters, parse_rig
from recordings.rig.mechanism import CONSTRAINTS, POSE
from recordings.sought import sought, with_level_x
from recordings.urdf import rig_from_urdf
from solver.mechanism.model import model_of
from solver.mechanism.rotation import exponential
from solver.mechanism.space import ParameterSpace
from solver.poses.wander import assembled

UP = np.eye(3)
ASIDE = exponential(np.array([0.0, np.pi / 2, 0.0])) @ exponential(np.array([0.0, 0.0, 0.3]))
FLAT = exponential(np.array([-np.pi / 2, 0.0, 0.0]))  # its z is the base's y


@pytest.mark.parametrize(
    ("rotation", "constraint", "held"),
    [
        (UP, "rigid", ""),
        (UP, "hinge", "rz"),
        (UP, "slider", "z"),
        (UP, "plane", "x y rz"),
        (UP, "ball", "rx ry rz"),
        (FLAT, "hinge", "ry"),
        (FLAT, "slider", "y"),
        (FLAT, "plane", "x z ry"),
        (ASIDE, "slider", "x"),
    ],
)
def test_what_a_freedom_undoes_is_held(rotation: np.ndarray, constraint: str, held: str) -> None:
    kept = sought(rotation, CONSTRAINTS[constraint])
    assert set(kept) == set(POSE) - set(held.split())


def test_a_level_x_takes_ry_away() -> None:
    level = with_level_x(ASIDE)
    assert level[2, 0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(level[:, 2], ASIDE[:, 2], atol=1e-12)
    assert len(sought(level, CONSTRAINTS["hinge"])) == 5


def arm(tool_rpy: str) -> str:
    """Six joints with a tool that points anywhere."""
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    links = "".join(f'<link name="l{k}"/>' for k in range(len(axes) + 2))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0.1 0.05 0.3" rpy="0.02 0.03 0.05"/><axis xyz="{axis}"/>'
        f'<limit lower="{0.2 + 0.05 * k}" upper="{0.6 + 0.15 * k}" effort="1" velocity="1"/></joint>'
        for k, axis in enumerate(axes)
    )
    last = len(axes)
    tool = (
        f'<joint name="held" type="fixed"><parent link="l{last}"/><child link="l{last + 1}"/>'
        f'<origin xyz="0.1 0 0.1" rpy="{tool_rpy}"/></joint>'
    )
    return f'<robot name="six">{links}{joints}{tool}</robot>'


@pytest.mark.parametrize("constraint", ["hinge", "slider", "plane"])
@pytest.mark.parametrize("tool_rpy", ["0.1 0 0", "1.5707963 0 0.4", "-0.4 1.1 0.2"])
def test_every_place_that_shows_is_reached(constraint: str, tool_rpy: str) -> None:
    """The sought coordinates move the closure in as many ways as all six together, and firmly."""
    rig = parse_rig(rig_from_urdf(arm(tool_rpy), f"l{7}", constraint))
    model, table = model_of(rig), parameters(rig)
    x = ParameterSpace.of(table).nominal
    home = assembled(rig, model, x)[None]
    names = [p.name for p in table]
    every = [names.index(f"fixture.{part}") for part in POSE]
    some = [i for i in every if table[i].identify]
    at = model.linearise(home, x, np.eye(len(x)))
    # What the freedoms at the end undo does not show.
    free = at.closure_by_coordinates[0][:, 6:]
    shown = np.linalg.svd(free)[0][:, free.shape[1] :].T
    ranks = [
        np.linalg.matrix_rank(shown @ at.closure_by_parameters[0][:, which], tol=1e-9)
        for which in (every, some)
    ]
    assert len(some) == 6 - len(CONSTRAINTS[constraint])
    assert ranks == [len(some)] * 2
    assert np.linalg.cond(shown @ at.closure_by_parameters[0][:, some]) < 20
