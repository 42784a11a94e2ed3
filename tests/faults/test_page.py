"""The page about faults: its table is the vocabulary, its kinds are those that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from recordings.faults import ENDED_BY, FaultKind
from recordings.rig import load_rig
from sim_devices.faults import FAULTS, FaultType, parse

PAGE = Path(__file__).parents[2] / "docs" / "howto-faults.md"
BETWEEN = re.compile(r"<!-- faults: begin -->\n(.*?)<!-- faults: end -->", re.DOTALL)


def row(fault: FaultType) -> str:
    amount = f" `{fault.amount}`" if fault.amount else ""
    return f"| `{fault.verb}`{amount} | {fault.target} | {fault.text} |"


def table() -> str:
    rows = [row(fault) for fault in FAULTS.values()]
    return "\n".join(["| fault | befalls | what happens |", "|---|---|---|", *rows, ""])


def test_the_table_of_faults_is_the_vocabulary() -> None:
    (found,) = BETWEEN.findall(PAGE.read_text("utf-8"))
    assert found == table(), f"the table should be:\n{table()}"


def test_the_script_of_the_page_can_be_played() -> None:
    (script,) = re.findall(r"```\n(# faults.txt\n.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(parse(script, load_rig("arm"))) == 4


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_of_fault_is_on_the_page(kind: FaultKind) -> None:
    text = PAGE.read_text("utf-8")
    repeating = kind.removesuffix("-over")
    assert f"`{kind}`" in text or (f"`{repeating}`" in text and ENDED_BY[repeating] == kind)
