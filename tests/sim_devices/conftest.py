"""Rigs on which nature is tried: the paper's two, and a planar one."""

from __future__ import annotations

import pytest

from recordings.rig import Rig, load_rig, parse_rig

FOUR_BAR = """
schema = 1
name = "four-bar"
[mechanism]
family = "serial"
closure = { constraint = "rigid" }
[[mechanism.joint]]
name = "crank"
a_m = 0.1
[[mechanism.joint]]
name = "elbow"
a_m = 0.3
[[mechanism.joint]]
name = "rocker"
a_m = 0.25
[[mechanism.joint]]
name = "ground"
a_m = 0.3
[[channel]]
name = "c1"
senses = "crank"
gain_deg_per_count = 0.01
[[channel]]
name = "c2"
senses = "elbow"
gain_deg_per_count = 0.01
[plan]
mode = "driven"
drives = ["crank"]
targets_deg = [[10], [60], [110], [200]]
revisit = { poses = 0, visits = 1 }
"""


@pytest.fixture
def four_bar_text() -> str:
    """A planar crank and rocker without homes; half of its closure rows are redundant."""
    return FOUR_BAR


@pytest.fixture
def four_bar() -> Rig:
    return parse_rig(FOUR_BAR)


@pytest.fixture
def arm() -> Rig:
    return load_rig("arm")


@pytest.fixture
def shoulder() -> Rig:
    return load_rig("shoulder")
