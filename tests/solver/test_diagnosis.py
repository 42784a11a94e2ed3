"""Bad input: a status and a remedy in words, never a confident wrong answer."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from recordings.rig import load_rig, parse_rig, rig_text
from solver.errors import MechanismError, NotEnoughData
from solver.estimate.trust_region import Status
from solver.result import result
from solver.samples import PoseTable
from solver.solve import Solution, solve_table
from tests.solver.synthetic import pose_table, solution


def with_counts(table: PoseTable, change: dict[int, np.ndarray]) -> PoseTable:
    counts = table.counts.copy()
    for channel, values in change.items():
        counts[:, channel] = values
    return replace(table, counts=counts)


def some(table: PoseTable, count: int) -> PoseTable:
    return replace(
        table,
        counts=table.counts[:count],
        sigma=table.sigma[:count],
        samples=table.samples[:count],
        effective=table.effective[:count],
        windows=table.windows[:count],
    )


def bad(solved: Solution, kind: str) -> str:
    (finding,) = [f for f in solved.findings if f.grade == "bad"]
    assert finding.kind == kind
    document = result(solved)
    assert document["status"] != "converged"
    assert {"kind": kind, "grade": "bad", "text": finding.text} in document["findings"]
    return finding.text


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_good_readings_raise_nothing(name: str) -> None:
    assert solution(name).findings == ()
    assert solution(name).estimate.status is Status.CONVERGED


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_what_a_model_lacks_is_no_mistake(name: str) -> None:
    solved = solution(name, bend_counts=20.0)
    assert solved.estimate.inflation > 5.0
    assert solved.estimate.status is Status.CONVERGED


def test_stuck_sensor() -> None:
    table = pose_table("arm", seed=3)
    stuck = with_counts(table, {2: np.full(60, table.counts[0, 2])})
    text = bad(solve_table(load_rig("arm"), stuck), "unexplained")
    assert "q3 reads the same at every pose" in text
    assert "sensor is stuck" in text


@pytest.mark.parametrize(("name", "jump"), [("arm", 3000.0), ("shoulder", 150.0)])
def test_poses_that_contradict_the_others(name: str, jump: float) -> None:
    table = pose_table(name, seed=3)
    values = table.counts[:, 1].copy()
    values[5] += jump
    solved = solve_table(load_rig(name), with_counts(table, {1: values}), poses=60)
    assert solved.estimate.status is Status.OUTLYING
    assert bad(solved, "outlying-poses").startswith("Dwell 5 ")


def test_unit_of_one_gain() -> None:
    text = rig_text("arm")[0].replace(
        "gain_deg_per_count = 0.0009 ", "gain_rad_per_count = 0.0009 ", 1
    )
    with pytest.raises(MechanismError, match=r"The gain of q1 is too large by 57.3.*deg where rad"):
        solve_table(parse_rig(text, "arm"), pose_table("arm", seed=3))


def told(rig: str, table: PoseTable) -> str:
    """What the solver says of ``table`` with a rig that has a mistake."""
    try:
        return bad(solve_table(parse_rig(rig, "rig"), table), "unexplained")
    except MechanismError as error:
        return str(error)


def test_unit_of_one_length() -> None:
    rig = rig_text("arm")[0].replace("s_m = 0.355", "s_mm = 0.355", 1)
    assert "joint3.s is too small by 1000: it looks like m where mm" in told(
        rig, pose_table("arm", seed=3)
    )


def test_unit_of_a_length_that_another_follows() -> None:
    rig = rig_text("shoulder")[0].replace(
        "y_mm = { nominal = 62.4, uncertainty = 0.5", "y_m = { nominal = 62.4, uncertainty = 0.5", 1
    )
    assert "A2.y is too large by 1000: it looks like mm where m" in told(
        rig, some(pose_table("shoulder", seed=3), 20)
    )


def test_unit_of_every_length() -> None:
    rig = re.sub(r"(?m)^([xyz])_mm =", r"\1_m =", rig_text("shoulder")[0])
    assert "Every length is too large by 1000" in told(
        rig, some(pose_table("shoulder", seed=3), 20)
    )


def test_sign_of_one_gain() -> None:
    table = pose_table("arm", seed=3)
    flipped = with_counts(table, {2: 400_000 - table.counts[:, 2]})
    with pytest.raises(MechanismError, match="The gain of q3 has the wrong sign"):
        solve_table(load_rig("arm"), flipped)


def test_exchanged_channels() -> None:
    table = pose_table("arm", seed=3)
    swapped = with_counts(table, {1: table.counts[:, 2], 2: table.counts[:, 1]})
    solved = solve_table(load_rig("arm"), swapped)
    assert "Channels q2 and q3 look exchanged" in bad(solved, "unexplained")


def test_readings_of_another_mechanism() -> None:
    table = pose_table("shoulder", seed=3)
    spread = 0.2 * np.ptp(table.counts, axis=0)
    noise = np.random.default_rng(0).standard_normal(table.counts.shape) * spread
    solved = solve_table(load_rig("shoulder"), replace(table, counts=table.counts + noise))
    assert solved.estimate.status is Status.UNEXPLAINED
    assert "recorded" not in bad(solved, "unexplained")


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_too_few_poses_and_poses_that_are_one(name: str) -> None:
    table = pose_table(name, seed=3)
    with pytest.raises(NotEnoughData, match=r"2 usable poses .* Record more poses"):
        solve_table(load_rig(name), some(table, 2))
    rng = np.random.default_rng(0)
    same = table.counts[:1] + table.sigma * rng.standard_normal(table.counts.shape)
    with pytest.raises(NotEnoughData, match="one and the same pose"):
        solve_table(load_rig(name), replace(table, counts=same))


def test_poses_that_hardly_differ_determine_only_in_part() -> None:
    table = pose_table("shoulder", seed=3)
    near = table.counts[:1] + 0.02 * (table.counts - table.counts[:1])
    solved = solve_table(load_rig("shoulder"), replace(table, counts=near))
    assert solved.identifiability.rank < 7
    assert len(result(solved)["unidentifiable"]) == 7 - solved.identifiability.rank


def test_an_answer_far_from_what_the_rig_states() -> None:
    table = pose_table("arm", seed=3)
    # Reading q6 half a turn off, as an encoder does whose zero was lost.
    counts = table.counts[:, 5] - 180 / 0.0439453125
    solved = solve_table(load_rig("arm"), with_counts(table, {5: counts}))
    assert solved.estimate.status is Status.FAR_FROM_NOMINAL
    assert "joint6.theta_offset ends" in bad(solved, "far-from-nominal")
