"""Where the end of a chain is in its base frame, when joints have origins of their own."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import parse_rig
from sim_devices.plant.creation import make_nature

RIG = """
schema = 1
name = "two"
[mechanism]
family = "serial"
closure = {{ constraint = "open" }}
{base}
[[mechanism.joint]]
name = "j1"
convention = "urdf"
z_m = 0.3
[[mechanism.joint]]
name = "j2"
convention = "urdf"
x_m = 1.0
[[channel]]
name = "c1"
senses = "j1"
gain_deg_per_count = 0.01
{effect}
"""
GROWTH = '[[effect]]\nname = "thermal-growth"\nwhere = "links"\nrate_per_s = 1e-3\n'


@pytest.mark.parametrize(("effect", "length"), [("", 1.0), (GROWTH, 1.1)])
def test_the_base_frame_lies_before_the_origin_of_the_next_joint(effect, length):
    at, time_s = np.array([[0.3, 0.2]]), np.array([100.0])
    start = make_nature(parse_rig(RIG.format(base="", effect=effect)), 0).mechanism
    turned, shifted = start.end(at, time_s)
    expected = length * np.array([np.cos(0.3), np.sin(0.3), 0.3])
    np.testing.assert_allclose(shifted[0], expected, atol=1e-12)
    np.testing.assert_allclose(turned[0], [np.cos(0.25), 0, 0, np.sin(0.25)], atol=1e-12)
    behind = make_nature(parse_rig(RIG.format(base='base = "j1"', effect=effect)), 0).mechanism
    turned, shifted = behind.end(at, time_s)
    np.testing.assert_allclose(shifted[0], [length, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turned[0], [np.cos(0.1), 0, 0, np.sin(0.1)], atol=1e-12)
