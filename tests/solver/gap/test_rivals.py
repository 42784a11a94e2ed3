"""Which candidates stay in the group: what fits as well is not dropped by chance or by its many forms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from solver.gap.search import Possible, grouped


def candidate(label: str, evidence: float, explained: float, *, enough: bool = True) -> Possible:
    tried = SimpleNamespace(
        effect=SimpleNamespace(label=label),
        log_evidence=evidence,
        explained=explained,
        enough=enough,
    )
    return cast(Possible, tried)


def group(*tried: Possible) -> list[str]:
    named = grouped(tried[0], tried)
    return [p.effect.label for p in (named.best, *named.rivals)]


def test_a_thousand_times_less_likely_and_a_worse_fit_is_no_rival() -> None:
    assert group(candidate("a", 40.0, 100.0), candidate("b", 30.0, 90.0)) == ["a"]


def test_as_good_a_fit_is_a_rival_however_many_coefficients_it_took() -> None:
    assert group(candidate("a", 40.0, 100.0), candidate("b", 20.0, 101.0)) == ["a", "b"]


def test_a_likelier_one_behind_which_something_stands_out_is_not_dropped() -> None:
    tried = (candidate("a", 44.0, 106.7, enough=False), candidate("b", 32.5, 109.5))
    assert group(*tried) == ["a", "b"]


def test_one_that_leaves_something_and_fits_worse_is_no_rival() -> None:
    tried = (candidate("a", 40.0, 100.0), candidate("b", 38.0, 80.0, enough=False))
    assert group(*tried) == ["a"]


def test_where_none_is_enough_the_best_stands_alone() -> None:
    tried = (candidate("a", 40.0, 100.0, enough=False), candidate("b", 39.0, 99.0, enough=False))
    assert group(*tried) == ["a"]
