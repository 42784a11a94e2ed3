"""Effects at channels against their closed forms, and against codes that are drawn and averaged."""

from __future__ import annotations

import numpy as np
import pytest

from recordings.rig import DescribedEffect, Quantity, load_rig
from solver.effects.effect import Effect, Recorded, Site
from solver.effects.registry import effect_kinds
from solver.errors import MechanismError
from solver.mechanism.circumstances import Circumstances

Array = np.ndarray
POSES = 40


def arm() -> Site:
    return Site(load_rig("arm"))


def values(site: Site, seed: int = 1) -> Array:
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (POSES, len(site.rig.channels)))


def at(channels: int) -> Circumstances:
    rng = np.random.default_rng(2)
    return Circumstances(
        time_s=np.arange(POSES) * 1.5,
        approach=rng.choice([-1.0, 0.0, 1.0], (POSES, channels)),
        rate=rng.normal(0.0, 0.4, (POSES, channels)),
        noise=np.full((POSES, channels), 2.0),
    )


def described(site: Site, name: str, where: str, **given: tuple[float, str]) -> Effect:
    quantities = {key: Quantity(value, dimension) for key, (value, dimension) in given.items()}
    return effect_kinds()[name].read(site, DescribedEffect(name, where, quantities))


def shifted(effect: Effect, v: Array, *coefficients: float) -> Array:
    shift = effect.seen(v, np.array(coefficients), at(v.shape[1]))
    assert shift is not None
    assert shift.targets.tolist() == [5]
    return shift.amount[:, 0]


def test_each_shift_is_its_closed_form() -> None:
    site = arm()
    v, around = values(site), at(7)
    q6 = v[:, 5]
    angle = (0.0, "angle")
    assert around.approach is not None
    assert around.rate is not None
    assert around.time_s is not None
    cases = {
        "eccentricity": (
            {"cos": angle, "sin": angle},
            (2e-3, 1e-3),
            2e-3 * np.cos(q6) + 1e-3 * np.sin(q6),
        ),
        "cyclic-error": (
            {"cos": angle, "sin": angle, "harmonic": (8.0, "ratio")},
            (2e-3, 1e-3),
            2e-3 * np.cos(8 * q6) + 1e-3 * np.sin(8 * q6),
        ),
        "backlash": ({"gap": angle}, (1e-3,), -0.5e-3 * around.approach[:, 5]),
        "offset-drift": ({"rate": (0.0, "angular speed")}, (1e-4,), 1e-4 * around.time_s),
        "offset-jump": (
            {"step": angle, "at": (15.0, "time")},
            (3e-3,),
            np.where(np.arange(POSES) >= 10, 3e-3, 0.0),
        ),
        "lag": ({"delay": (0.0, "time")}, (0.01,), -0.01 * around.rate[:, 5]),
    }
    for name, (given, coefficients, expected) in cases.items():
        effect = described(site, name, "q6", **given)
        np.testing.assert_allclose(shifted(effect, v, *coefficients), expected, atol=1e-15)


def test_crosstalk_is_a_share_of_the_other_channels_counts() -> None:
    site = arm()
    v = values(site)
    effect = described(site, "crosstalk", "q6<-q7", ratio=(0.0, "ratio"))
    q6, q7 = (site.described(name) for name in ("q6", "q7"))
    counts = (v[:, 6] - q7.offset.nominal) / q7.gain.nominal
    expected = q6.gain.nominal * 0.02 * counts
    np.testing.assert_allclose(shifted(effect, v, 0.02), expected, atol=1e-15)
    assert set(type(effect).places(site)) == {"q6<-q7", "q7<-q6"}


def drawn(law, mean: Array, sigma: float) -> Array:
    """Mean codes of many readings around each of ``mean`` (P,), rounded and put through ``law``."""
    rng = np.random.default_rng(3)
    codes = np.round(rng.normal(mean[:, None], sigma, (len(mean), 40_000))).astype(np.int64)
    return law(codes).mean(axis=1)


@pytest.mark.parametrize(("bit", "value"), [(0, 0), (3, 1), (4, 0), (10, 1)])
def test_codes_with_a_stuck_bit_have_the_mean_of_codes_that_are_drawn(bit: int, value: int) -> None:
    site = arm()
    effect = described(
        site, "stuck-bit", "q6", bit=(float(bit), "ratio"), value=(float(value), "ratio")
    )
    counts = np.tile(np.linspace(1000.0, 1100.0, POSES)[:, None], (1, 7))
    coded = effect.coded(counts, np.zeros(0), at(7))
    assert coded is not None
    assert coded.channel == 5
    mask = np.int64(1 << bit)
    expected = drawn(lambda c: c | mask if value else c & ~mask, counts[:, 5], 2.0)
    scatter = 5 * (2.0 + 2.0**bit) / np.sqrt(40_000)
    np.testing.assert_allclose(coded.counts, expected, atol=scatter)
    assert effect.size(np.zeros(0), counts, at(7)) == pytest.approx(
        2**bit * abs(site.nominal("q6.gain"))
    )


@pytest.mark.parametrize(("bit", "value"), [(3, 1), (4, 0)])
def test_codes_with_a_stuck_bit_climb_like_the_reading_over_a_whole_tooth(
    bit: int, value: int
) -> None:
    """The slope is the secant's over one tooth of the saw: a search that saw the jumps would not end."""
    site = arm()
    effect = described(
        site, "stuck-bit", "q6", bit=(float(bit), "ratio"), value=(float(value), "ratio")
    )
    counts = np.tile(np.linspace(1000.0, 1100.0, POSES)[:, None], (1, 7))
    tooth = 2.0 ** (bit + 1)
    here, up, down = (effect.coded(counts + s, np.zeros(0), at(7)) for s in (0, tooth, -tooth))
    assert here is not None
    assert up is not None
    assert down is not None
    np.testing.assert_allclose(here.slope, (up.counts - down.counts) / (2 * tooth), atol=1e-6)


def test_clipped_codes_have_the_mean_of_codes_that_are_drawn() -> None:
    site = arm()
    effect = described(site, "saturation", "q6", low=(1020.0, "count"), high=(1080.0, "count"))
    counts = np.tile(np.linspace(1000.0, 1100.0, POSES)[:, None], (1, 7))
    coded = effect.coded(counts, np.array([1020.0, 1080.0]), at(7))
    assert coded is not None
    expected = drawn(lambda c: np.clip(c, 1020, 1080), counts[:, 5], 2.0)
    # Rounding spreads a reading a little more than its noise: at the rail, by s / 96.
    np.testing.assert_allclose(coded.counts, expected, atol=0.06)


def test_one_rail_is_enough_and_is_found_where_counts_pile_up() -> None:
    site = arm()
    kind = effect_kinds()["saturation"]
    counts = np.tile(np.linspace(1000.0, 1100.0, POSES)[:, None], (1, 7))
    clipped = np.minimum(counts, 1070.0)
    (found,) = kind.variants(site, "q6", Recorded(values(site), at(7), clipped))
    assert [(c.name, c.start) for c in found.coefficients] == [("high", 1070.0)]
    assert kind.variants(site, "q6", Recorded(values(site), at(7), counts)) == ()
    with pytest.raises(MechanismError, match="neither"):
        described(site, "saturation", "q6")
    entry = found.entry([1070.0])
    assert dict(entry.values).keys() == {"high"}
    v = site.nominal("q6.gain") * (counts - 2048) + site.nominal("q6.offset")
    assert found.size(np.array([1070.0]), v, at(7)) == pytest.approx(
        30.0 * abs(site.nominal("q6.gain"))
    )


def test_a_length_sensor_turns_once_in_its_turn() -> None:
    rig = load_rig("hangprinter")
    channels = tuple(c.model_copy(update={"turn": 0.2}) for c in rig.channels)
    site = Site(rig.model_copy(update={"channels": channels}))
    kind = effect_kinds()["eccentricity"]
    assert kind.places(Site(rig)) == ()
    assert kind.places(site) == tuple(c.name for c in channels)
    v = np.full((1, len(channels)), 0.05)  # a quarter of a turn
    shift = kind(site, channels[0].name).seen(v, np.array([1e-3, 2e-3]), Circumstances())
    assert shift is not None
    np.testing.assert_allclose(shift.amount, [[2e-3]], atol=1e-15)


def test_harmonics_are_those_that_the_poses_tell_apart() -> None:
    site = arm()
    kind = effect_kinds()["cyclic-error"]

    def harmonics(v: Array) -> list[float]:
        forms = kind.variants(site, "q1", Recorded(v, at(7)))
        return [form.settings["harmonic"].nominal for form in forms]

    turning = np.random.default_rng(4).uniform(-3, 3, (200, 7))
    assert harmonics(turning) == list(range(2, 41))
    few = harmonics(0.05 * turning)  # 17 degrees: neighbouring harmonics look alike
    assert few[0] == 2
    assert len(few) < 12
    assert harmonics(np.ones((200, 7))) == []


def test_what_circumstances_cannot_show_is_said_in_words() -> None:
    site, kinds = arm(), effect_kinds()
    still = Circumstances(time_s=np.arange(4.0), approach=np.ones((4, 7)), rate=np.zeros((4, 7)))
    assert "standstill only" in str(kinds["lag"].untestable(site, "q6", still))
    assert "one side only" in str(kinds["backlash"].untestable(site, "q6", still))
    assert "before and after" in str(kinds["offset-jump"].untestable(site, "q6", still))
    assert "nobody knows" in str(kinds["backlash"].untestable(site, "q6", Circumstances()))
    assert "nobody knows" in str(kinds["offset-drift"].untestable(site, "q6", Circumstances()))
    around = at(7)
    for name in ("lag", "backlash", "offset-jump", "offset-drift"):
        assert kinds[name].untestable(site, "q6", around) is None


def test_an_entry_reads_back_as_the_effect_that_wrote_it() -> None:
    site = arm()
    v, around = values(site), at(7)
    recorded = Recorded(v, around, np.round(2048 + v / 1e-3))
    for kind in effect_kinds().values():
        for where in kind.places(site)[:1]:
            for form in kind.variants(site, where, recorded)[:3]:
                numbers = [c.start + 0.5 * c.plausible for c in form.coefficients]
                again = kind.read(site, form.entry(numbers))
                assert again.label == form.label
                assert dict(again.settings) == dict(form.settings)
                assert [c.name for c in again.coefficients] == [c.name for c in form.coefficients]
