"""Which cases a blind benchmark plays: mechanisms, effects, strengths, noises. Owns no physics.

A case is settled by its key and the benchmark's seed alone, so that a run can be resumed,
shortened or lengthened without changing the cases that it shares with another.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.effects.registry import EFFECT_KINDS, OUTSIDER_KINDS
from sim_devices.plant.noise import Noise

STRENGTHS = (9.0, 25.0, 64.0, 225.0, 900.0)
"""Squared lengths of an effect's trace in noise units; 225 is fifteen standard deviations."""

STRONG = 225.0
"""From here on an effect ought to be named, not only noticed."""

MECHANISMS = ("arm", "shoulder", "stewart", "wrist")

NOISES = {
    "clean": Noise(),
    "autocorrelated": Noise(correlation_samples=5.0),
    "heavy-tailed": Noise(heavy_tails=True),
    "visits": Noise(visits=2.0),
}
"""White and normal, and three ways in which laboratory noise is neither."""

_SHORT = ("arm", "shoulder")
_SHORT_SINGLES, _SHORT_NULLS = 10, 8

_OWN = ("stewart", "wrist")
"""Rigs that lie in this folder; the others are bundled."""


@dataclass(frozen=True, slots=True)
class Case:
    """One recording to be made and analysed.

    Attributes:
        mechanism: one of `MECHANISMS`.
        kind: "single", "double", "null" or "outsider".
        names: of the effects to be hidden; where they sit is drawn.
        strength: wanted of each of them.
        noise: a key of `NOISES`.
        number: tells cases apart that agree in all else.
        seed: of all that is random in it.
    """

    mechanism: str
    kind: str
    names: tuple[str, ...]
    strength: float
    noise: str
    number: int
    seed: int

    @property
    def key(self) -> str:
        """Names the case, whatever benchmark it is in."""
        return _key(self.mechanism, self.kind, self.names, self.strength, self.noise, self.number)


def rig_of(mechanism: str) -> str:
    """Text of the rig file of one of `MECHANISMS`."""
    if mechanism in _OWN:
        return (files("loopcal.blind") / "rigs" / f"{mechanism}.toml").read_text("utf-8")
    return rig_text(mechanism)[0]


def cases(
    seed: int,
    *,
    runs: int,
    mechanisms: Sequence[str] = MECHANISMS,
    strengths: Sequence[float] = STRENGTHS,
    only: str | None = None,
) -> tuple[Case, ...]:
    """The whole grid.

    Args:
        seed: of the benchmark.
        runs: cases of every mechanism, effect and strength; nulls and doubles are as many as
            make their rates comparable.
        mechanisms: some of `MECHANISMS`.
        strengths: some of `STRENGTHS`.
        only: one effect's name: single cases of it and nothing else; "null", "double" and
            "outsider" stand for all of a kind.
    """
    out: list[Case] = []
    for number in range(runs):
        begin = len(out)
        for mechanism in mechanisms:
            rig = parse_rig(rig_of(mechanism), mechanism)
            present = [name for name, kind in EFFECT_KINDS.items() if kind.places(rig)]
            strange = [name for name, kind in OUTSIDER_KINDS.items() if kind.places(rig)]
            for kind, names, strength, noise, several in _layout(present, strange, strengths):
                if only is not None and only not in (kind, *names[: kind == "single"]):
                    continue
                for k in range(several):
                    at = number * several + k
                    key = _key(mechanism, kind, names, strength, noise, at)
                    own = zlib.crc32(f"{seed}/{key}".encode())
                    out.append(Case(mechanism, kind, names, strength, noise, at, own))
        # In an order by chance, so that a run that is ended early has seen a bit of everything.
        out[begin:] = sorted(out[begin:], key=lambda case: case.seed)
    return tuple(out)


def short_cases(seed: int) -> tuple[Case, ...]:
    """A sample of the grid that takes a minute or two: strong effects and nulls of two mechanisms."""
    grid = cases(seed, runs=1, mechanisms=_SHORT, strengths=(STRONG,))
    singles = [case for case in grid if case.kind == "single"]
    nulls = [case for case in grid if case.kind == "null"]
    return (*singles[:_SHORT_SINGLES], *nulls[:_SHORT_NULLS])


def _layout(
    present: Sequence[str], strange: Sequence[str], strengths: Sequence[float]
) -> Iterator[tuple[str, tuple[str, ...], float, str, int]]:
    """Kind, names, strength, noise, and how many of them a run has."""
    for name in present:
        for strength in strengths:
            yield "single", (name,), strength, "clean", 1
    for name in strange:
        yield "outsider", (name,), STRONG, "clean", 2
    yield "null", (), 0.0, "clean", 10
    for noise in NOISES:
        if noise != "clean":
            yield "null", (), 0.0, noise, 5
    # The names of a double are drawn with its places: two stars stand for any two.
    yield "double", ("*", "*"), STRONG, "clean", 5


def _key(
    mechanism: str, kind: str, names: Sequence[str], strength: float, noise: str, number: int
) -> str:
    what = "+".join(names) if names else noise
    return f"{mechanism}/{kind}/{what}/{strength:g}/{number}"
