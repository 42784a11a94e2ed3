"""Forward kinematics with effects: the way from the end to the readings, walked back."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import Rig, load_rig, parameters, parse_rig, rig_text
from solver.calibration import Calibration
from solver.effects.needs import loaded
from solver.errors import MechanismError
from solver.estimate.nuisance import Observations
from solver.forward import forward, read, sensed_all_the_way
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace

EFFECTS = """
[[effect]]
name = "nonlinearity"
where = "q6"
p2_deg = { nominal = 0.8, uncertainty = 1, identify = true }
p3_deg = { nominal = -0.5, uncertainty = 1, identify = true }
low_deg = -60
high_deg = 60

[[effect]]
name = "crosstalk"
where = "q6<-q7"
ratio_percent = { nominal = 3, uncertainty = 1, identify = true }

[[effect]]
name = "joint-compliance"
where = "joint2"
compliance_deg_per_Nm = { nominal = 0.02, uncertainty = 0.01, identify = true }

[[effect]]
name = "link-geometry"
where = "joint5.s"
change_mm = { nominal = 4, uncertainty = 1, identify = true }
"""


def grown() -> Rig:
    """The arm, guided by hand, with effects at its sensors, its joints and its links."""
    text = rig_text("arm")[0].replace(
        'family = "serial"', 'family = "serial"\nstanding = "gravity-compensated"', 1
    )
    return parse_rig(text + EFFECTS)


@pytest.fixture(scope="module")
def walked():
    """The model, its parameters, free coordinates, and readings and end there, with all circumstances."""
    rig = grown()
    model, space = model_of(rig), ParameterSpace.of(parameters(rig))
    x = space.nominal
    u = np.random.default_rng(2).uniform(-0.6, 0.6, (20, len(model.coordinate_names)))
    nothing = Observations(np.zeros((20, 7)), np.ones((20, 7)), Circumstances())
    at = loaded(model, nothing, u, x, None).at
    there = model.linearise(u, x, space.expansion, at)
    return model, space, x, u, Observations(there.readings, np.ones((20, 7)), at)


def test_the_end_is_where_the_readings_come_from(walked) -> None:
    model, space, x, u, observed = walked
    assert sensed_all_the_way(model)
    found = forward(model, observed, x, space.expansion)
    end = model.end_pose(u, x, space.expansion, observed.at)
    np.testing.assert_allclose(found.end.position, end.position, atol=1e-9)
    np.testing.assert_allclose(found.end.rotation, end.rotation, atol=1e-9)
    plain = model_of(load_rig("arm"))
    without = forward(plain, observed, x[: model.named], np.zeros((model.named, 0)))
    assert np.linalg.norm(without.end.position - end.position, axis=1).min() > 1e-3


def test_a_link_that_is_longer_reaches_further(walked) -> None:
    model, space, x, u, observed = walked
    name = "link-geometry@joint5.s.change"
    longer = x.copy()
    longer[[p.name for p in space.table].index(name)] += 1e-3
    moved = model.end_pose(u, longer, space.expansion, observed.at).position
    moved = moved - model.end_pose(u, x, space.expansion, observed.at).position
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1e-3, rtol=1e-9)


def test_derivatives_are_those_of_differences(walked) -> None:
    model, space, x, _, observed = walked
    found = forward(model, observed, x, space.expansion)
    step = 1e-6
    for k, name in enumerate(space.names):
        ends = [
            forward(model, observed, x + s * step * space.expansion[:, k], space.expansion).end
            for s in (1, -1)
        ]
        slope = (ends[0].position - ends[1].position) / (2 * step)
        np.testing.assert_allclose(
            found.end.by_parameters[:, :3, k], slope, atol=2e-7, rtol=1e-6, err_msg=name
        )
    for channel in range(7):
        counts = np.zeros_like(observed.counts)
        counts[:, channel] = 1.0
        ends = [
            forward(
                model,
                Observations(observed.counts + s * counts, observed.sigma, observed.at),
                x,
                space.expansion,
            ).end
            for s in (1, -1)
        ]
        slope = (ends[0].position - ends[1].position) / 2
        np.testing.assert_allclose(found.by_readings[:, :3, channel], slope, atol=1e-9, rtol=1e-4)


def test_a_calibration_with_effects_holds_away_from_the_fixture(walked) -> None:
    model, space, x, u, observed = walked
    calibration = Calibration(model, space, x, np.zeros((len(space.names),) * 2))
    poses = calibration.end_poses(observed.counts, observed.sigma)
    end = model.end_pose(u, x, space.expansion, observed.at)
    # Loads are those at the angles that the sensors show: a compliance later, nearly the same.
    np.testing.assert_allclose(poses.position, end.position, atol=2e-5)
    assert np.isnan(poses.misfit).all()
    assert poses.covariance[:, 0, 0].min() > 0


def test_a_chain_with_a_joint_that_nobody_senses_has_no_forward_way() -> None:
    rig = load_rig("arm")
    slack = rig.model_copy(update={"channels": tuple(c for c in rig.channels if c.name != "q4")})
    model, x = model_of(slack), np.array([p.nominal for p in parameters(slack)])
    observed = Observations(np.zeros((1, 6)), np.ones((1, 6)))
    assert not sensed_all_the_way(model)
    with pytest.raises(MechanismError, match="a sensor at every joint"):
        forward(model, observed, x, np.zeros((len(x), 0)))
    assert not sensed_all_the_way(model_of(load_rig("shoulder")))
    with pytest.raises(MechanismError, match="chain of joints"):
        read(model_of(load_rig("shoulder")), np.zeros((1, 4)), x)
