"""Fault scripts: what the lines mean, and what is said about those that mean nothing."""

from __future__ import annotations

import pytest

from recordings.rig import Rig, load_rig
from sim_devices.errors import SimDevicesError
from sim_devices.faults.script import ScriptError, parse, parse_line
from sim_devices.faults.vocabulary import FAULTS, Amount, Target


@pytest.fixture(scope="module")
def arm() -> Rig:
    return load_rig("arm")


def test_a_script_is_lines_in_order(arm: Rig) -> None:
    orders = parse(
        """
        # what goes wrong in the third second
        at 3 s unplug wrist-adc for 2 s   # and comes back
        at 2500ms corrupt arm-wrist 10%

        at 9 s end corrupt arm-wrist
        delay wrist-adc 150 ms for 1 s
        at 4 s renumber encoder3 to 9
        babble arm-can 5000 /s
        replug wrist-adc
        restart drive1
        """,
        arm,
    )
    assert [(o.at_s, o.fault.verb, o.target, o.ends, o.amount, o.for_s) for o in orders] == [
        (3.0, "unplug", "wrist-adc", False, None, 2.0),
        (2.5, "corrupt", "arm-wrist", False, 10.0, None),
        (9.0, "corrupt", "arm-wrist", True, None, None),
        (None, "delay", "wrist-adc", False, 0.15, 1.0),
        (4.0, "renumber", "encoder3", False, 9.0, None),
        (None, "babble", "arm-can", False, 5000.0, None),
        (None, "unplug", "wrist-adc", True, None, None),
        (None, "restart", "drive1", False, None, None),
    ]
    assert orders[0].text == "unplug wrist-adc for 2 s"


def test_every_fault_of_the_table_can_be_written(arm: Rig) -> None:
    names = {
        Target.CAN_PORT: "arm-can",
        Target.LINE_PORT: "arm-wrist",
        Target.CAN_DEVICE: "encoder1",
        Target.LINE_DEVICE: "wrist-adc",
        Target.CHANNEL: "q3",
    }
    amounts = {
        Amount.NONE: "",
        Amount.PERCENT: "5 %",
        Amount.RATE: "100 /s",
        Amount.ADDRESS: "to 99",
        Amount.TIME: "20 ms",
    }
    for fault in FAULTS.values():
        for target in fault.befalls:
            line = f"at 1 s {fault.verb} {names[target]} {amounts[fault.amount]}"
            order = parse_line(f"{line} for 2 s" if fault.lasts else line, arm)
            assert order is not None
            assert order.fault is fault


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("at 3 s unplgu wrist-adc", ["word 4, 'unplgu'", "babble, bus-off", "mean 'unplug'?"]),
        ("at 3 s", ["ends too early", "expected a fault: babble"]),
        ("at soon unplug wrist-adc", ["word 2, 'soon'", "'3 s' or '250 ms'"]),
        ("at 3 min unplug wrist-adc", ["word 3, 'min'", "units of time are: s, ms"]),
        ("unplug wrist-acd", ["word 2, 'wrist-acd'", "arm-can, arm-wrist", "mean 'wrist-adc'?"]),
        ("unplug", ["ends too early", "wrist-adc"]),
        ("bus-off encoder1", ["'encoder1'", "that is a device on a CAN port", "rig: arm-can"]),
        ("corrupt encoder1 5 %", ["'corrupt' befalls a port or a device on a serial or TCP port"]),
        ("corrupt wrist-adc", ["ends too early", "'corrupt' needs 'P %'"]),
        ("corrupt wrist-adc 5", ["the end", "such as '10 %'"]),
        ("corrupt wrist-adc 500 %", ["above 0 and at most 100"]),
        ("babble arm-can much", ["word 3, 'much'", "'babble' needs 'N /s'"]),
        ("renumber encoder1 9", ["word 3, '9'", "such as 'to 9'"]),
        ("renumber encoder1 to 2.5", ["a whole number from 1 to 247"]),
        ("delay wrist-adc for 2 s", ["word 3, 'for'", "'3 s' or '250 ms'"]),
        ("silence encoder1 2 s", ["word 3, '2'", "should end here, or go on with 'for'"]),
        ("restart encoder1 for 2 s", ["happens once and has no duration"]),
        ("end restart encoder1", ["happens once and has no end"]),
        ("end silence encoder1 now", ["word 4, 'now'", "should end here"]),
        ("then silence encoder1", ["word 1, 'then'", "expected a fault"]),
    ],
)
def test_what_is_wrong_is_named_with_what_is_valid(arm: Rig, line: str, words: list[str]) -> None:
    with pytest.raises(ScriptError) as caught:
        parse(f"# a comment\n{line}", arm)
    message = str(caught.value)
    assert message.startswith(f"line 2 of the fault script, '{line}'")
    for each in words:
        assert each in message
    assert isinstance(caught.value, SimDevicesError)


def test_a_rig_without_a_fitting_target_says_so() -> None:
    with pytest.raises(ScriptError, match="this rig has none"):
        parse("bus-off shoulder-adc", load_rig("shoulder"))


@pytest.mark.parametrize("line", ["", "   ", "# nothing", "\t# at 3 s unplug"])
def test_nothing_is_no_order(arm: Rig, line: str) -> None:
    assert parse_line(line, arm) is None
