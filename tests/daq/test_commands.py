"""Commands that interlocks and states forbid: they do not reach the wire, and say so."""

from __future__ import annotations

import pytest

from daq import Interlocked, ManualClock, NotAllowed
from daq.drives import Drives
from daq.interlocks import Interlocks
from daq.mobility import counted
from daq.states import SessionStates, Step
from recordings.events import Fault, Mode, ModeCommand, ModeReport


@pytest.fixture
def commanded(arm):
    """Drives in the armed state, and what was recorded."""
    recorded: list = []
    clock = ManualClock()
    states = SessionStates(clock, recorded.append)
    states.take(Step.ARM, "test")
    drives = Drives(
        joints={joint: drive for link in arm.links for joint, drive in link.joints.items()},
        scales={},
        states=states,
        interlocks=Interlocks(arm.rig, counted(arm.rig)),
        seen=lambda joint: None,
        clock=clock,
        record=recorded.append,
    )
    yield drives, recorded
    drives.close()


def test_a_forbidden_command_does_not_reach_the_wire_and_is_recorded(arm, commanded):
    drives, recorded = commanded
    for joint in ("joint1", "joint2"):
        drives.set_mode(joint, Mode.POSITION, "test")
    before = list(arm.log)
    with pytest.raises(Interlocked, match="over-constrain") as caught:
        drives.set_mode("joint3", Mode.POSITION, "test")
    assert caught.value.source == "joint3"
    assert arm.log == before
    assert isinstance(recorded[-1], Fault)
    assert (recorded[-1].source, recorded[-1].kind) == ("joint3", "interlock")
    assert sum(isinstance(event, ModeCommand) for event in recorded) == 2


def test_a_joint_that_did_not_answer_still_counts_as_held(arm, commanded):
    drives, _ = commanded
    for joint in ("joint1", "joint2"):
        drives.set_mode(joint, Mode.POSITION, "test")
    drive = arm.link("arm-can").joints["joint2"]
    drive.broken = True
    with pytest.raises(Exception, match="does not answer"):
        drives.set_mode("joint2", Mode.FREE, "test")
    with pytest.raises(Interlocked, match="over-constrain"):
        drives.set_mode("joint3", Mode.POSITION, "test")


def test_a_drive_that_says_that_it_holds_counts_as_held(arm, commanded):
    drives, _ = commanded
    drives.set_mode("joint1", Mode.POSITION, "test")
    held = ModeReport("joint2", drives_clock(drives).now_ns() + 1, Mode.POSITION, 0x27)
    drives._seen = lambda joint: held if joint == "joint2" else None
    with pytest.raises(Interlocked, match="over-constrain"):
        drives.set_mode("joint3", Mode.POSITION, "test")
    # What it said before it answered that it is free is no news.
    drives_clock(drives).advance(1.0)
    drives.set_mode("joint2", Mode.FREE, "test")
    drives.set_mode("joint3", Mode.POSITION, "test")


def test_nothing_is_led_from_where_nobody_knows_that_it_is(arm, commanded):
    drives, _ = commanded
    drives.set_mode("joint1", Mode.POSITION, "test")
    drives._states.take(Step.MOVE, "test")
    with pytest.raises(NotAllowed, match="nobody said where it holds"):
        drives.move_to("joint1", 200_000, "test")
    assert arm.targets == {}


def test_a_torque_beyond_its_limit_does_not_reach_the_wire(arm, commanded):
    drives, _ = commanded
    drives._states.take(Step.MOVE, "test")
    with pytest.raises(Interlocked, match="its limit is 0 %"):
        drives.set_torque("joint1", 10, "test")


def drives_clock(drives: Drives) -> ManualClock:
    return drives._clock
