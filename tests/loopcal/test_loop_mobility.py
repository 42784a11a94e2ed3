"""How closed loops can move, and what `loopcal rig check` says of plans that would hold too much."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.mobility import counted
from loopcal.loop_mobility import mobility_of
from recordings.rig import load_rig, parse_rig, rig_text


@pytest.mark.parametrize("name", ["arm", "shoulder", "stewart", "hangprinter"])
def test_generic_loops_move_as_their_joints_and_constraints_count(name: str) -> None:
    rig = load_rig(name)
    found = mobility_of(rig)
    assert found.freedoms == counted(rig).freedoms
    assert found.fights(found.places[: found.freedoms + 1])


def test_the_planned_drives_of_the_arm_may_be_held_and_its_elbow_not_with_the_hinge() -> None:
    rig = load_rig("arm")
    found = mobility_of(rig)
    assert rig.plan is not None
    assert found.fights(rig.plan.drives) == ""
    # The hinge's angle alone sets how far the hand is from the shoulder, and so the elbow's.
    assert "cannot move independently" in found.fights(("hinge", "joint4"))


FOUR_BAR = (
    """
schema = 1
name = "four-bar"
[mechanism]
family = "serial"
closure = { constraint = "rigid" }
"""
    + "".join(
        f"""
[[mechanism.joint]]
name = "j{n}"
home_deg = {home}
a_m = {a}
"""
        for n, (home, a) in enumerate(((90, 0.2), (-90, 0.3), (-90, 0.2), (-90, 0.3)), start=1)
    )
    + "".join(
        f"""
[[channel]]
name = "q{n}"
senses = "j{n}"
gain_deg_per_count = 0.01
"""
        for n in range(1, 5)
    )
)


def test_a_planar_four_bar_moves_though_the_count_says_that_it_cannot() -> None:
    rig = parse_rig(FOUR_BAR)
    assert counted(rig).freedoms == 0
    found = mobility_of(rig)
    assert found.freedoms == 1
    assert found.fights(("j1",)) == ""
    assert "mobility 1" in found.fights(("j1", "j3"))
    assert found.motions is not None
    assert np.abs(found.motions[:, :, 0]).min() > 0.1


def test_rig_check_finds_what_the_interlocks_would_refuse(loopcal, tmp_path: Path) -> None:
    text = rig_text("arm")[0]
    drive = load_rig("arm").plan.drives[0]
    path = tmp_path / "arm.toml"
    path.write_text(
        f'{text}\n[interlocks]\njoint = [{{ name = "{drive}", speed_deg_per_s = 1 }}]\n', "utf-8"
    )
    outcome = loopcal("rig", "check", path)
    assert outcome.exit_code == 1
    assert f"the plan moves {drive}" in outcome.output
    assert "its limit is" in outcome.output
