"""Plans of rigs with several fixtures: stops that all of them allow, and predictions that their session keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.planning import plan_text
from recordings.reader import read_recording
from recordings.rig import parse_rig
from sim_devices.simulate import simulate
from solver.errors import MechanismError
from solver.poses.planning import plan_session
from solver.solve import solve
from tests.sim_devices.test_plant_fixtures import RIG


def test_a_session_through_two_fixtures_reaches_the_predicted_errors(tmp_path: Path) -> None:
    plan = plan_session(parse_rig(RIG), poses=12)
    assert plan.held == ()
    assert len(plan.plan.drives) == 1
    assert plan.predicted is not None
    text = RIG[: RIG.index("[plan]")] + plan_text(parse_rig(RIG), plan)
    file = tmp_path / "session.mcap"
    simulate(parse_rig(text), text, file, seed=5)
    recording = read_recording(file)
    assert recording.faults == ()
    solved = solve(recording, poses=1000)
    assert len(solved.table.counts) == 2 * (12 + 2)
    reached = np.sqrt(np.diag(solved.estimate.covariance)) / solved.estimate.inflation
    ratio = reached / plan.predicted.errors
    assert (np.abs(ratio - 1.0) < 0.35).all(), ratio


def test_the_known_distance_is_counted() -> None:
    # With the tip's length free as well, only the distance says how large the arm is.
    text = RIG.replace(
        "x_m = 0.15", "x_m = { nominal = 0.15, uncertainty = 0.003, identify = true }"
    )
    apart, channel = text.index("[[mechanism.distance]]"), text.index("[[channel]]")
    assert plan_session(parse_rig(text), poses=12).held == ()
    without = plan_session(parse_rig(text[:apart] + text[channel:]), poses=12)
    assert without.held == ("the common scale of all lengths",)


def test_fixtures_that_share_no_stop_are_told() -> None:
    # Driven at the shoulder, the elbow cannot reach both: the second lies on the other side.
    text = RIG.replace("x_m = { nominal = 0.43", "x_m = { nominal = -0.43").replace(
        "distance_mm = { nominal = 50", "distance_mm = { nominal = 810"
    )
    text = text.replace("home_deg = 45", "home_deg = 45\nlimits_deg = [0, 100]")
    with pytest.raises(MechanismError, match=r"all of its 2 fixtures|does not close"):
        plan_session(parse_rig(text), poses=12)
