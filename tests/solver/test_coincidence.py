"""An unsensed joint on the axis of another, and fixtures in one place: named, with what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recordings.rig import Rig, load_rig, parse_rig, rig_text
from solver.coincidence import coaxial_joints, coincident_fixtures
from solver.estimate.trust_region import Status
from solver.rig_check import check_rig
from solver.solve import solve_table
from tests.solver.test_immobile_joints import anthropomorphic, table
from tests.solver.test_serial_general import arm, at_home, solved


def hinged(a_m: str, alpha_deg: str, s_m: str = "0.014") -> Rig:
    """The bundled arm with another link between its hinge and joint 1."""
    text = rig_text("arm")[0]
    for key, value, given in (
        ("a_m", "0.202", a_m),
        ("alpha_deg", "-38.5", alpha_deg),
        ("s_m", "0.014", s_m),
    ):
        stated = f"{key} = {{ nominal = {value},"
        assert text.count(stated) == 1
        text = text.replace(stated, f"{key} = {{ nominal = {given},")
    return parse_rig(text, "arm")


@pytest.mark.parametrize("alpha", ["0", "180"])
def test_a_hinge_on_the_axis_of_joint_1_is_named(alpha: str) -> None:
    (found,) = coaxial_joints(hinged("0", alpha))
    assert found.names == ("hinge", "joint1")
    assert found.sure
    assert "what q1 reads tells nothing" in found.text


def test_within_the_uncertainties_it_may_be_there() -> None:
    # The rig states 5 mm and 1 deg.
    (found,) = coaxial_joints(hinged("0.004", "0.8"))
    assert not found.sure
    assert "may have one and the same axis" in found.text
    assert coaxial_joints(hinged("0.006", "0.8")) == ()
    assert coaxial_joints(hinged("0.004", "1.2")) == ()


@pytest.mark.parametrize("shape", [("0.202", "0"), ("0", "-38.5"), ("0.202", "-38.5")])
def test_axes_beside_or_askew_are_none(shape: tuple[str, str]) -> None:
    assert coaxial_joints(hinged(*shape)) == ()


def test_across_the_place_where_the_loop_closes() -> None:
    (found,) = coaxial_joints(anthropomorphic("hinge", known=True))
    assert found.names == ("end.rz", "joint7")
    assert coaxial_joints(anthropomorphic("rigid")) == ()
    assert coaxial_joints(load_rig("stewart")) == ()


def test_the_check_counts_it_as_a_mistake() -> None:
    mistakes = check_rig(anthropomorphic("hinge", known=True)).mistakes
    (said,) = [m for m in mistakes if "only the sum of their angles acts" in m]
    assert "end.rz" in said
    assert "joint7" in said
    assert "Mount" in said


def test_the_solve_says_it_too() -> None:
    rig = anthropomorphic("hinge", known=True)
    said = [f.text for f in solve_table(rig, table(rig)).findings]
    assert any("end.rz" in text and "joint7" in text and "Mount" in text for text in said), said


def held(apart: float, *, stated: str = "", closure: str = "rigid", rz: float = 0.0) -> Rig:
    """A chain held in two fixtures ``apart`` [m] from each other, the second turned by ``rz`` [rad]."""
    text = f"""schema = 1
name = "two"
[mechanism]
family = "serial"
closure = {{ constraint = "{closure}" }}
[[mechanism.fixture]]
name = "left"
x_m = 0.3
[[mechanism.fixture]]
name = "right"
x_m = {0.3 + apart}
rz_rad = {rz}
{stated}
[[mechanism.joint]]
name = "joint1"
a_m = {{ nominal = 0.3, uncertainty = 0.001, identify = true }}
[[channel]]
name = "q1"
senses = "joint1"
gain_deg_per_count = 0.001
"""
    return parse_rig(text, "two")


def test_fixtures_in_one_place_are_named_with_the_distance_they_contradict() -> None:
    (found,) = coincident_fixtures(held(0.0))
    assert found.names == ("left", "right")
    assert found.sure
    assert not found.contradicted
    distance = (
        "[[mechanism.distance]]\nbetween = ['left', 'right']\n"
        "distance_m = { nominal = 0.25, uncertainty = 1e-4 }"
    )
    (found,) = coincident_fixtures(held(0.0, stated=distance))
    assert found.contradicted
    assert "known distance of 250 mm between them" in found.text
    assert coincident_fixtures(held(0.25, stated=distance)) == ()


def test_a_turn_about_a_hinge_is_no_other_place() -> None:
    assert coincident_fixtures(held(0.0, rz=0.5)) == ()
    assert len(coincident_fixtures(held(0.0, rz=0.5, closure="hinge"))) == 1
    assert len(coincident_fixtures(held(0.0, rz=0.5, closure="ball"))) == 1


def test_dwells_of_one_place_under_two_names_contradict_the_distance_between_them() -> None:
    here = at_home(np.zeros(3))
    there = here + np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    closure = 'constraint = "ball"'
    single, _ = solved(arm(closure, (here,)), 3, 14)
    windows = tuple(
        replace(window, fixture=f"hole_{i % 2}") for i, window in enumerate(single.table.windows)
    )
    both = arm(closure, (here, there))
    assert coincident_fixtures(both) == ()
    solution = solve_table(both, replace(single.table, windows=windows), poses=len(windows))
    assert solution.estimate.status is Status.UNEXPLAINED, solution.findings
    (said,) = [f.text for f in solution.findings if f.grade == "bad"]
    assert "states 100 mm between fixtures hole_0 and hole_1" in said
    assert "one and the same place" in said
