"""An effect of one's own, as the guide writes it: found by its entry point, solved for, kept apart."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recordings.rig import DescribedEffect, Quantity, load_rig, parameters
from solver.effects import registry
from solver.effects.effect import Effect, Site
from solver.effects.gain_error import GainError
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances
from solver.solve import solve_table
from tests.solver.effects.grown_rigs import recorded

GUIDE = Path(__file__).parents[3] / "docs" / "howto-own-effect.md"


@pytest.fixture(scope="module")
def guide() -> dict[str, Any]:
    """What the Python of the guide defines."""
    names: dict[str, Any] = {"__name__": "guide"}
    for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text("utf-8"), re.S):
        exec(block, names)
    return names


@dataclass(frozen=True)
class Entry:
    """An entry point, as `importlib.metadata` has them."""

    name: str
    value: str
    kind: Any

    def load(self) -> Any:
        return self.kind


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Entry]]:
    """Entry points that the registry finds."""
    entries: list[Entry] = []

    def found(*, group: str) -> list[Entry]:
        assert group == "loopcal.effects"
        return entries

    monkeypatch.setattr(registry, "entry_points", found)
    registry.effect_kinds.cache_clear()
    yield entries
    registry.effect_kinds.cache_clear()


def test_the_guides_effect_is_solved_for(guide: dict[str, Any], installed: list[Entry]) -> None:
    installed.append(Entry("cable-pull", "my_package.cable:CablePull", guide["CablePull"]))
    pull = Quantity(0.0, "ratio", 0.01, identify=True)
    rig = load_rig("arm").model_copy(
        update={"effects": (DescribedEffect("cable-pull", "q6", {"pull": pull}),)}
    )
    table = recorded(rig, 0.02, poses=40)
    solved = solve_table(rig, table, poses=40)
    names = solved.estimate.space.names
    k = names.index("cable-pull@q6.pull")
    error = np.sqrt(solved.estimate.covariance[k, k])
    value = solved.estimate.parameters[[p.name for p in parameters(rig)].index(names[k])]
    assert abs(value - 0.02) < 4 * error
    assert error < 0.005


def test_the_guides_derivatives_are_exact(guide: dict[str, Any]) -> None:
    effect: Effect = guide["CablePull"](Site(load_rig("arm")), "q6")
    values = np.random.default_rng(1).uniform(-1, 1, (5, 7))
    assert guide["derivative_error"](effect, values, np.array([0.02]), Circumstances()) < 1e-9


def test_a_name_that_is_taken_is_refused(installed: list[Entry]) -> None:
    installed.append(Entry("again", "other:GainError", GainError))
    with pytest.raises(MechanismError, match="taken already"):
        registry.effect_kinds()


def test_what_is_no_effect_is_refused(installed: list[Entry]) -> None:
    installed.append(Entry("odd", "other:odd", dict))
    with pytest.raises(MechanismError, match="expected a subclass of Effect"):
        registry.effect_kinds()
