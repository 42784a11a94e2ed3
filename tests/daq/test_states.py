"""The state machine of a session: what its tables say is what it does, and what the document shows."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

import daq
from daq import ManualClock, NotAllowed
from daq.states import ALLOWED, TRANSITIONS, SessionStates, Step
from recordings.events import Mode, SessionState, StateChange
from recordings.rig import parse_rig, rig_text

SAFETY = (Path(daq.__file__).parent.parent / "docs" / "safety.md").read_text("utf-8")


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table behind a heading of the document."""
    start = SAFETY.index(f"\n{heading}\n")
    table = re.search(r"^\|.*\n\|[-| ]+\n((?:\|.*\n)+)", SAFETY[start:], re.MULTILINE)
    assert table is not None
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in table[1].splitlines()]


def reach(state: SessionState) -> SessionStates:
    """A session in ``state``, by the shortest way."""
    ways = {
        SessionState.IDLE: (),
        SessionState.ARMED: (Step.ARM,),
        SessionState.MOVING: (Step.ARM, Step.MOVE),
        SessionState.RECORDING: (Step.ARM, Step.RECORD),
        SessionState.SAFE: (Step.MAKE_SAFE,),
    }
    states = SessionStates(ManualClock(), lambda change: None)
    for step in ways[state]:
        states.take(step, "test")
    return states


def test_the_document_shows_the_transitions() -> None:
    expected = [
        [row.before.name.lower(), str(row.step), row.after.name.lower(), row.when]
        for row in TRANSITIONS
    ]
    assert rows("## Transitions") == expected


def test_the_document_shows_what_each_state_allows() -> None:
    said = {True: "yes", False: "no"}
    expected = [
        [
            state.name.lower(),
            allowed.meaning,
            *(said[x] for x in (allowed.modes, allowed.targets, allowed.vouched)),
        ]
        for state, allowed in ALLOWED.items()
    ]
    assert rows("## States") == expected


@pytest.mark.parametrize(("state", "step"), list(itertools.product(SessionState, Step)))
def test_every_step_does_what_the_table_says_or_is_refused_in_words(
    state: SessionState, step: Step
) -> None:
    states = reach(state)
    before = states.changes
    after = [row.after for row in TRANSITIONS if (row.before, row.step) == (state, step)]
    if after:
        states.take(step, "because")
        assert [states.now] == after
        assert states.changes == (*before, StateChange(0, state, after[0], "because"))
        return
    with pytest.raises(NotAllowed, match=f"'{step}'.*{state.name}.*only '"):
        states.take(step, "because")
    assert (states.now, states.changes) == (state, before)


def test_every_state_leads_to_safe_and_safe_only_to_idle() -> None:
    to_safe = {row.before for row in TRANSITIONS if row.after is SessionState.SAFE}
    assert to_safe == set(SessionState) - {SessionState.SAFE}
    assert {row.after for row in TRANSITIONS if row.before is SessionState.SAFE} == {
        SessionState.IDLE
    }


@pytest.mark.parametrize("state", SessionState)
def test_commands_are_refused_where_the_state_does_not_allow_them(state: SessionState) -> None:
    states = reach(state)
    states.require_mode("joint1", Mode.OFF)
    for allowed, ask in (
        (ALLOWED[state].modes, lambda: states.require_mode("joint1", Mode.FREE)),
        (ALLOWED[state].targets, lambda: states.require_target("joint1")),
    ):
        if allowed:
            ask()
        else:
            with pytest.raises(NotAllowed, match=rf"joint1.*{state.name}"):
                ask()


def test_the_documents_example_is_a_rigs() -> None:
    (example,) = re.findall(r"^```toml\n(.*?)^```", SAFETY, re.MULTILINE | re.DOTALL)
    rig = parse_rig(f"{rig_text('arm')[0]}\n{example}")
    assert rig.interlocks.arming == 120
    assert [joint.name for joint in rig.interlocks.joints] == ["joint1", "joint7"]
