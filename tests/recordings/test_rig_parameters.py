"""The parameter tables of the two bundled rigs, against the papers' tables."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import Parameter, load_rig, parameters, parse_rig
from recordings.rig.quantity import Tie

DEGREE = np.pi / 180


def table(rig: str) -> dict[str, Parameter]:
    return {parameter.name: parameter for parameter in parameters(load_rig(rig))}


def shown(found: dict[str, Parameter], identify: bool) -> dict[str, tuple[float, str]]:
    return {
        name: (round(p.nominal / p.to_si, 9), p.unit)
        for name, p in found.items()
        if p.identify is identify
    }


def test_names_and_units_of_the_arm() -> None:
    found = table("arm")
    joints = ["hinge", *(f"joint{i}" for i in range(1, 8))]
    names = [f"{joint}.{part}" for joint in joints for part in ("theta_offset", "s", "a", "alpha")]
    names += [f"q{i}.{part}" for i in range(1, 8) for part in ("offset", "gain")]
    assert list(found) == names
    for name, parameter in found.items():
        part = name.partition(".")[2]
        units = {"s": "m", "a": "m", "gain": "deg/count"}
        assert parameter.unit == units.get(part, "deg")
        dimensions = {"m": "length", "deg": "angle", "deg/count": "angle/count"}
        assert parameter.dimension == dimensions[parameter.unit]


def test_unknowns_of_the_arm() -> None:
    """The 14 unknowns of Giugovaz & Hollerbach, starting from their Table 2."""
    found = table("arm")
    offsets = (9.9, -122.8, -21.1, -9.2, 27.1, 116.3, 89.3)
    expected = {f"joint{i}.theta_offset": (value, "deg") for i, value in enumerate(offsets, 1)}
    expected |= {
        "hinge.a": (0.202, "m"),
        "hinge.s": (0.014, "m"),
        "hinge.alpha": (-38.5, "deg"),
        "joint1.s": (0.273, "m"),
        "joint7.a": (-0.101, "m"),
        "joint7.s": (0.038, "m"),
        "joint7.alpha": (99.8, "deg"),
    }
    assert shown(found, identify=True) == expected
    assert all(found[name].uncertainty for name in expected)


def test_fixed_geometry_of_the_arm() -> None:
    """Table 1: a1 ... a6 = 0, s2 = s4 = s6 = 0, s3, s5, alternating twists of 90 deg."""
    fixed = shown(table("arm"), identify=False)
    assert [fixed[f"joint{i}.a"][0] for i in range(1, 7)] == [0] * 6
    assert [fixed[f"joint{i}.s"][0] for i in range(2, 7)] == [0, 0.355, 0, 0.32, 0]
    assert [fixed[f"joint{i}.alpha"][0] for i in range(1, 7)] == [90, -90, 90, -90, 90, -90]
    assert fixed["hinge.theta_offset"] == (0, "deg")
    assert fixed["q1.gain"] == (0.0009, "deg/count")
    assert fixed["q6.gain"] == (0.043945312, "deg/count")
    assert not any(p.uncertainty for p in table("arm").values() if not p.identify)


def test_names_and_units_of_the_shoulder() -> None:
    found = table("shoulder")
    points = ("A1", "A2", "A3", "A4", "B1", "B2")
    names = [f"{point}.{axis}" for point in points for axis in "xyz"]
    names += [f"d{i}.{part}" for i in range(1, 5) for part in ("offset", "gain")]
    assert list(found) == names
    for name, parameter in found.items():
        assert parameter.unit == ("m/count" if name.endswith(".gain") else "m")
        assert parameter.to_si == 1


def test_unknowns_of_the_shoulder() -> None:
    """The 7 unknowns of Nahvi, Hollerbach & Hayward, in metres."""
    assert shown(table("shoulder"), identify=True) == {
        "A1.x": (0.0687, "m"),
        "A2.x": (-0.0288, "m"),
        "A2.y": (0.0624, "m"),
        "d1.offset": (0.097, "m"),
        "d2.offset": (0.1003, "m"),
        "d3.offset": (0.0951, "m"),
        "d4.offset": (0.1002, "m"),
    }


def test_ties_of_the_shoulder() -> None:
    """A3 = -A2 and A4 = -A1 by design."""
    found = table("shoulder")
    assert {name: p.tie for name, p in found.items() if p.tie is not None} == {
        "A3.x": Tie("A2.x", -1.0),
        "A3.y": Tie("A2.y", -1.0),
        "A4.x": Tie("A1.x", -1.0),
    }
    assert found["A3.x"].nominal == pytest.approx(0.0288)
    assert found["A4.x"].nominal == pytest.approx(-0.0687)
    assert not any(p.identify for p in found.values() if p.tie is not None)


def test_units_of_the_file_do_not_change_the_values(rig_toml: str) -> None:
    other = rig_toml.replace("a_m = 0.3", "a_mm = 300").replace(
        "gain_deg_per_count = 0.01", f"gain_rad_per_count = {0.01 * DEGREE!r}"
    )
    for one, two in zip(parameters(parse_rig(rig_toml)), parameters(parse_rig(other)), strict=True):
        assert (one.name, one.unit) == (two.name, two.unit)
        assert one.nominal == pytest.approx(two.nominal, rel=1e-15)


def test_uncertainty_and_factor_of_a_tie(rig_toml: str) -> None:
    text = rig_toml.replace("a_m = 0.3", 'a_m = { tie = "-0.5 * elbow.a" }')
    found = {parameter.name: parameter for parameter in parameters(parse_rig(text))}
    assert found["base.a"].nominal == pytest.approx(-0.125)
    assert found["base.a"].tie == Tie("elbow.a", -0.5)
    assert found["elbow.a"].uncertainty == pytest.approx(0.001)
    assert found["slide.theta_offset"].unit == "deg"
