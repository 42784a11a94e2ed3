"""The automatic choice of parameters ends at a well-posed set, one held a step."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from loopcal.cli import app
from recordings.rig import load_rig
from solver.parameter_choice import SURE, choose_parameters


@pytest.mark.parametrize(("name", "parameters"), [("shoulder", 23), ("arm", 46)])
def test_holds_one_a_step_until_what_is_left_is_well_posed(name: str, parameters: int) -> None:
    found = choose_parameters(load_rig(name))
    assert [step.free for step in found.steps] == list(range(parameters, len(found.chosen) - 1, -1))
    last = found.steps[-1]
    assert last.held is None
    assert last.sigma_min >= SURE
    assert last.condition <= 1000.0
    assert all(s.sigma_min < SURE or s.condition > 1000.0 for s in found.steps[:-1])
    assert not {step.held for step in found.steps} & set(found.chosen)


def test_a_stricter_limit_keeps_fewer() -> None:
    rig = load_rig("shoulder")
    assert len(choose_parameters(rig, condition=100.0).chosen) < len(choose_parameters(rig).chosen)


def test_the_command_shows_the_table() -> None:
    done = CliRunner().invoke(app, ["rig", "choose", "shoulder"])
    assert done.exit_code == 0
    assert "these will do" in done.output
    assert "identify: A1.x" in done.output
