"""What a report says: verdict, findings, limits, numbers with as many digits as they deserve, the summary."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from solver.estimate.correlation import Correlation
from solver.estimate.null_directions import NullDirection
from solver.estimate.trust_region import Status
from solver.report.comparison import compare
from solver.report.misfit import unnoticed
from solver.report.notation import decimals_for, figures, fine_unit, fixed, plain, signed, typeset
from solver.report.summary import summary
from solver.report.verdict import Verdict, certificate, verdict
from solver.solve import Solution
from tests.solver.synthetic import solution, truth_shown


def judge(solved: Solution, name: str | None = None) -> Verdict:
    return verdict(solved, compare(solved, None if name is None else truth_shown(name)))


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_a_good_solve_is_called_good(name: str) -> None:
    found = judge(solution(name), name)
    assert found.grade == "good"
    assert found.headline.startswith("Calibrated: the model explains the readings")
    assert found.remedy is None
    told = re.search(r"Against the truth: (\d+) of (\d+) parameters", " ".join(found.findings))
    assert told is not None
    near, total = map(int, told.groups())
    assert total == len(solution(name).estimate.space.names)
    assert near >= total - 1


@pytest.mark.parametrize(("name", "channel"), [("arm", "q6"), ("shoulder", "d")])
def test_an_unmodelled_nonlinearity_is_told_and_located(name: str, channel: str) -> None:
    solved = solution(name, bend_counts=12.0)
    found = judge(solved)
    assert found.grade == "caution"
    times = math.sqrt(solved.estimate.misfit)
    assert f"{times:.1f}" in found.headline or f"{times:.0f}" in found.headline
    assert any(
        words.startswith(f"What the model misses shows most at {channel}")
        for words in found.findings
    )
    assert found.limits[0].startswith("What the model lacks")


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.CONVERGED])
def test_no_result_comes_with_its_remedy(status: Status) -> None:
    solved = solution("shoulder")
    found = judge(replace(solved, estimate=replace(solved.estimate, status=status)))
    assert found.grade == "bad"
    assert found.headline.startswith("No result")
    assert found.remedy == status.value
    assert found.findings == ()


def test_undetermined_combinations_are_named() -> None:
    solved = solution("shoulder")
    held = np.zeros((7, 1))
    held[3] = 1.0
    direction = NullDirection("d1.offset, which no pose shows", held[:, 0], ("d1.offset",))
    part = replace(
        solved.identifiability,
        rank=6,
        held=held,
        directions=(direction,),
        held_by=("nominal values",),
    )
    bad = replace(solved, identifiability=part)
    found = judge(bad)
    assert (
        found.headline
        == "Calibrated in part: these poses leave 1 combination of parameters undetermined."
    )
    assert (
        found.findings[0]
        == "Not determined: d1.offset, which no pose shows. Held at nominal values."
    )
    assert [row.name for row in compare(bad) if row.held] == ["d1.offset"]


def test_a_large_condition_number_is_not_acceptable() -> None:
    solved = solution("shoulder")
    found = judge(replace(solved, scaled=replace(solved.scaled, condition=140.0)))
    assert found.grade == "caution"
    fact = next(fact for fact in found.facts if fact.label == "Condition number")
    assert (fact.value, fact.grade) == ("140", "caution")
    assert fact.note.startswith("not acceptable: the limit is 100")


def test_disagreeing_methods_are_told() -> None:
    solved = solution("shoulder")
    other = solved.beside[0]
    moved = other.parameters + other.space.expansion @ (9 * other.standard_errors)
    found = judge(replace(solved, beside=(replace(other, parameters=moved),)))
    assert any(words.startswith("The method multi-loop disagrees") for words in found.findings)
    agreed = judge(solved)
    assert any(words.startswith("The method multi-loop agrees") for words in agreed.findings)


def test_a_surprising_move_is_told() -> None:
    solved = solution("shoulder")
    jump = np.zeros(7)
    jump[0] = 5e-3
    estimate = replace(
        solved.estimate,
        parameters=solved.estimate.parameters + solved.estimate.space.expansion @ jump,
    )
    found = judge(replace(solved, estimate=estimate))
    assert any(
        words.startswith("Largest move for its stated uncertainty: A1.x")
        and "more than it should" in words
        for words in found.findings
    )


@pytest.mark.parametrize(
    ("value", "bound", "words"),
    [
        (1.0, 1.0, "within 0.1 %"),
        (0.9995, 1.0, "within 0.1 %"),
        (0.95, 1.0, "within 5.0 %"),
        (1.0, math.inf, "no bound"),
    ],
)
def test_the_certificate_never_promises_more_than_the_bound(
    value: float, bound: float, words: str
) -> None:
    solved = solution("shoulder")
    selection = replace(solved.selection, value=value, upper_bound=bound)
    assert certificate(replace(solved, selection=selection)).startswith(words)


def test_comparison_speaks_mm_and_keeps_truth_in_the_same_unit() -> None:
    rows = {row.name: row for row in compare(solution("shoulder"), truth_shown("shoulder"))}
    row = rows["A1.x"]
    assert row.unit.name == "mm"
    assert row.nominal == pytest.approx(68.7)
    assert row.prior == pytest.approx(0.5)
    assert row.truth == pytest.approx(1e3 * truth_shown("shoulder")["A1.x"])
    assert abs(row.in_errors(row.estimate.value - row.truth)) < 5
    assert compare(solution("shoulder"), {"A2.x": -0.03})[0].truth is None


def test_summary_has_a_row_a_parameter_and_one_line_of_verdict() -> None:
    solved = solution("arm")
    told = summary(solved)
    assert [row[0] for row in told.rows] == list(solved.estimate.space.names)
    assert {len(row) for row in told.rows} == {len(told.columns)}
    assert "\n" not in told.verdict
    angle = next(row for row in told.rows if row[0] == "joint1.theta_offset")
    truth = truth_shown("arm")["joint1.theta_offset"]
    assert float(angle[1]) == pytest.approx(truth, abs=5 * float(angle[2]))
    assert float(angle[3]) == pytest.approx(float(angle[1]) - 9.9, abs=1e-4)
    assert angle[4] == "deg"


def test_summary_without_result_carries_the_remedy() -> None:
    solved = solution("shoulder")
    told = summary(replace(solved, estimate=replace(solved.estimate, status=Status.NO_PROGRESS)))
    assert told.grade == "bad"
    assert "check units, signs and the order of channels" in told.verdict


@pytest.mark.parametrize(
    ("error", "decimals"),
    [
        (0.05, 3),
        (0.0123, 3),
        (1.2, 1),
        (35.0, 0),
        (9.4e-12, 9),
        (0.0, 4),
        (math.nan, 4),
        (math.inf, 4),
    ],
)
def test_an_error_is_shown_with_two_digits(error: float, decimals: int) -> None:
    assert decimals_for(error) == decimals


def test_numbers_are_written_as_people_write_them() -> None:
    assert fixed(-0.0001, 2) == "0.00"
    assert fixed(math.nan, 2) == "–"
    assert (signed(0.5, 1), signed(-0.5, 1), signed(0.001, 1)) == ("+0.5", "-0.5", "0.0")
    assert [figures(v) for v in (0, 0.5, 999.6, 14564.2, 4.7e16, 1.3e-5, math.inf, math.nan)] == [
        "0", "0.500", "1000", "14564", "4.70×10¹⁶", "1.30×10⁻⁵", "∞", "–"
    ]  # fmt: skip
    assert plain(0.3 * 0.1 / 0.1) == "0.3"
    assert typeset("multi-loop moved -0.5 mm (-3), 10-20") == "multi-loop moved −0.5 mm (−3), 10-20"


def test_fine_units_keep_numbers_readable() -> None:
    assert fine_unit("length", 0.002).name == "mm"
    assert fine_unit("length", 2e-5).name == "µm"
    assert fine_unit("angle", math.radians(2.0)).name == "deg"
    assert fine_unit("angle", math.radians(0.002)).name == "mdeg"


def test_few_degrees_of_freedom_are_not_called_a_check() -> None:
    solved = solution("shoulder")
    few = replace(solved.estimate, freedoms=1, misfit=1.0)
    found = judge(replace(solved, estimate=few))
    assert found.grade == "caution"
    assert found.headline.startswith("Calibrated, but hardly checked: with 1 degree of freedom")
    assert unnoticed(1) > 10.0 > unnoticed(5) > unnoticed(100) > 1.0
    assert unnoticed(0) == math.inf


def test_residuals_that_neighbours_share_are_told() -> None:
    solved = solution("shoulder")
    count = len(solved.estimate.space.names)
    alike = Correlation(6.0, 1.0, np.diag(np.diag(solved.estimate.covariance)))
    found = judge(replace(solved, estimate=replace(solved.estimate, correlation=alike)))
    assert found.grade == "caution"
    assert "neighbouring poses leave residuals that are alike" in found.headline
    assert any(fact.label == "Neighbouring poses" for fact in found.facts)
    assert "only as far as the model does" in found.limits[0]
    assert alike.widening.shape == (count, count)
