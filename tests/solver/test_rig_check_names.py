"""What `rig check` says generic poses leave open: frames and scales by name, not as lists of parameters."""

from __future__ import annotations

import re

import numpy as np

from recordings.rig import load_rig, parameters, parse_rig, rig_text
from solver.estimate.null_directions import point_frames
from solver.mechanism.model import model_of
from solver.mechanism.space import ParameterSpace
from solver.rig_check import check_rig


def all_points_identified(name: str) -> str:
    """The bundled rig with every coordinate of a point identified."""
    text = rig_text(name)[0]
    return re.sub(
        r"^([xyz])_mm = (-?[\d.]+)$", r"\1_mm = { nominal = \2, identify = true }", text, flags=re.M
    )


def test_shifts_and_turns_of_frames_are_named() -> None:
    found = check_rig(parse_rig(all_points_identified("stewart"), "stewart"))
    assert found.identifiability is not None
    words = found.identifiability.combinations
    frames = [
        w for w in words if re.fullmatch(r"a (shift|turn) of all (base|plate) points .* [xyz]", w)
    ]
    assert len(frames) >= 6, words
    assert set(found.remarks) >= {f"generic poses do not determine: {w}" for w in words}


def test_each_plate_point_of_the_shoulder_has_a_scale_of_its_own() -> None:
    found = check_rig(load_rig("shoulder-all")).identifiability
    assert found is not None
    assert found.combinations == (
        "the common scale of all lengths and gains",
        "the scale of B1 with its legs alone (A1, d1, A2, d2)",
    )
    moved = {name.partition(".")[0] for name in found.directions[1].members}
    assert moved == {"A1", "A2", "B1", "d1", "d2"}


def test_that_scale_leaves_every_reading_as_it_is() -> None:
    rig = load_rig("shoulder-all")
    found = check_rig(rig).identifiability
    assert found is not None
    model = model_of(rig)
    space = ParameterSpace.of(parameters(rig))
    turned = 0.3 * np.random.default_rng(0).standard_normal((20, 3))
    change = found.directions[1].change
    nominal = space.reduce(space.nominal)
    moved = change != 0
    share = change[moved] / nominal[moved]
    assert np.ptp(share) < 1e-9 * np.abs(share).max()
    nowhere = space.expansion[:, :0]
    before = model.linearise(turned, space.nominal, nowhere).readings
    scaled = space.expand(space.reduce(space.nominal) + 0.05 * change / share[0])
    # 5 % of the size of half the mechanism, finite and not only to first order.
    np.testing.assert_allclose(model.linearise(turned, scaled, nowhere).readings, before, atol=1e-6)
    assert np.abs(scaled - space.nominal).max() > 1e-3


def test_points_that_legs_join_are_one_group() -> None:
    assert point_frames(load_rig("shoulder")).joined == (
        ("B1", "A1", "d1", "A2", "d2"),
        ("B2", "A3", "d3", "A4", "d4"),
    )
    # A leg from A2 to B2 joins what was apart; a free plate has one scale for all.
    text = rig_text("shoulder")[0]
    leg = text.index("[[mechanism.leg]]", text.index('name = "leg2"'))
    joined = (
        text[:leg] + '[[mechanism.leg]]\nname = "leg5"\nbase = "A2"\nplate = "B2"\n' + text[leg:]
    )
    assert point_frames(parse_rig(joined)).joined == ()
    assert point_frames(load_rig("stewart")).joined == ()
    assert point_frames(load_rig("arm")).points == {}
