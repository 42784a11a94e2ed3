"""Making a case: draw a place, scale the effect to the strength that is wanted, record, seal the truth.

Owns what may be asked of nature: sizes stay within `MOST` of what is met in practice, and an
effect that cannot reach its strength within them, at any of a few places, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopcal.blind.grid import NOISES, Case, rig_of
from loopcal.blind.strength import Bench, Trace
from recordings.rig import Rig, parse_rig
from sim_devices.plant.effects.registry import EFFECT_KINDS, OUTSIDER_KINDS
from sim_devices.plant.effects.size import channel_unit
from sim_devices.plant.effects.stuck_bit import StuckBit
from sim_devices.plant.errors import BadEffect
from sim_devices.simulate import simulate

MOST = 10.0
"""An effect may be this many times as large as the largest of a few typical ones."""

_KINDS = {**EFFECT_KINDS, **OUTSIDER_KINDS}
LEAST_RETAINED = 1e-4
"""An effect that keeps less is a change of frames, of which only squares and rounding show."""

_TYPICAL = 16
_PLACES = 4
_PAIRS = 8
_ROUNDS = 6
_CLOSE = 1.05
_NEAR = 2.5
"""Strength over the wanted one: close enough to stop, and near enough for the case to count."""
_NEAR_BIT = 10.0
"""The same of bits, the next of which is far stronger: dither hides the one and not the other."""
_BITS = 24
_DISTINCT = 0.5
"""Fraction of the strength of each of a double that must be left beside the other."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect of a case.

    Attributes:
        name, where, size, unit: as nature tells it.
        strength: lambda.
        retained: kappa.
        nearest: label of the rival that could best stand in for it.
        nearest_leaves: squared length that it leaves of the trace, in noise units.
        own_leaves: the same of the effect's own form; None where the solver has no such candidate.
    """

    name: str
    where: str
    size: float
    unit: str
    strength: float
    retained: float
    nearest: str
    nearest_leaves: float
    own_leaves: float | None


@dataclass(frozen=True, slots=True)
class Sealed:
    """What the solver is not told.

    Attributes:
        key, mechanism, kind, strength, noise, seed: of the case.
        hide: as `loopcal simulate --hide` takes it.
        effects: at work.
        left_out: why the case was not made, or None.
    """

    key: str
    mechanism: str
    kind: str
    strength: float
    noise: str
    seed: int
    hide: tuple[str, ...]
    effects: tuple[Hidden, ...]
    left_out: str | None = None


class OutOfReach(Exception):
    """No physical size of the effect has the strength that is wanted."""


def make(case: Case, recording: Path) -> Sealed:
    """Write the recording of ``case`` and return what is to be sealed.

    Args:
        case: what is wanted.
        recording: file to create; it is not created when the case is left out.

    Raises:
        SimDevicesError: the mechanism cannot carry out its plan.
        SolverError: not even the plain session can be fitted.
    """
    text = rig_of(case.mechanism)
    rig = parse_rig(text, case.mechanism)
    rng = np.random.default_rng([case.seed, 1])
    hidden: list[tuple[str, Trace]] = []
    bench = None
    if case.kind != "null":
        bench = Bench(rig, text, case.seed, recording.parent)
        try:
            hidden = (
                _pair(bench, rig, case, rng)
                if len(case.names) > 1
                else [_one(bench, rig, case.names[0], case.strength, rng)]
            )
        except OutOfReach as why:
            return left_out(case, str(why))
    hide = tuple(text for text, _ in hidden)
    truth = simulate(rig, text, recording, seed=case.seed, hide=hide, noise=NOISES[case.noise])
    effects = []
    for told, (_, trace) in zip(truth.effects, hidden, strict=True):
        rival = ("", 0.0, None) if bench is None else bench.nearest(trace, told.name, told.where)
        effects.append(
            Hidden(
                told.name,
                told.where,
                told.size,
                told.unit,
                trace.strength,
                trace.retained,
                *rival,
            )
        )
    return _sealed(case, hide, tuple(effects))


def left_out(case: Case, why: str) -> Sealed:
    """What is sealed of a case that could not be made."""
    return _sealed(case, (), (), why)


def _sealed(
    case: Case, hide: tuple[str, ...], effects: tuple[Hidden, ...], why: str | None = None
) -> Sealed:
    return Sealed(
        case.key,
        case.mechanism,
        case.kind,
        case.strength,
        case.noise,
        case.seed,
        hide,
        effects,
        why,
    )


def _one(
    bench: Bench,
    rig: Rig,
    name: str,
    strength: float,
    rng: np.random.Generator,
    beside: tuple[str, ...] = (),
) -> tuple[str, Trace]:
    """An effect of ``name`` at a random place where it can be that strong."""
    places = _KINDS[name].places(rig)
    for where in rng.permutation(np.array(places, dtype=object))[:_PLACES]:
        found = (
            _bit(bench, rig, str(where), strength, beside)
            if name == StuckBit.name
            else _scaled(bench, rig, name, str(where), strength, rng, beside)
        )
        if found is not None:
            return found
    raise OutOfReach(f"{name} reaches no strength of {strength:g} within physical sizes")


def _pair(bench: Bench, rig: Rig, case: Case, rng: np.random.Generator) -> list[tuple[str, Trace]]:
    """Two effects at random, each as strong as wanted and neither hidden behind the other."""
    names = [name for name, kind in EFFECT_KINDS.items() if kind.places(rig)]
    for _ in range(_PAIRS):
        chosen = rng.choice(names, size=2)
        try:
            first = _one(bench, rig, str(chosen[0]), case.strength, rng)
            pair = [first, _one(bench, rig, str(chosen[1]), case.strength, rng, (first[0],))]
        except (OutOfReach, BadEffect):
            continue
        alike = pair[0][0].partition("=")[0] == pair[1][0].partition("=")[0]
        if not alike and _distinct(pair[0][1], pair[1][1]):
            return pair
    raise OutOfReach(f"no pair of effects that differ enough at a strength of {case.strength:g}")


def _distinct(one: Trace, other: Trace) -> bool:
    """Whether enough of each is left beside the other; one that shows in motion only is distinct."""
    if len(one.left) != len(other.left):
        return True
    for mine, rival in ((one, other), (other, one)):
        direction = rival.left.mean(axis=1)[:, None]
        unit = direction / np.linalg.norm(direction)
        if mine.beside(unit) < _DISTINCT * mine.strength:
            return False
    return True


def _scaled(
    bench: Bench,
    rig: Rig,
    name: str,
    where: str,
    strength: float,
    rng: np.random.Generator,
    beside: tuple[str, ...],
) -> tuple[str, Trace] | None:
    """An effect at one place, as near to ``strength`` as it comes; None where it does not."""
    kind = _KINDS[name]
    typical = [_number(kind.typical(rig, where, rng)) for _ in range(_TYPICAL)]
    size, percent = typical[0]
    largest = MOST * max(abs(number) for number, _ in typical)
    best: tuple[float, str, Trace] | None = None
    for _ in range(_ROUNDS):
        size = math.copysign(min(abs(size), largest), size)
        text = f"{name}@{where}={size:.8g}{percent}"
        try:
            trace = bench.trace(text, beside)
        except BadEffect:
            largest = 0.5 * abs(size)  # more than this place can have
            size *= 0.25
            continue
        off = abs(math.log(max(trace.strength, 1e-3) / strength))
        if best is None or off < best[0]:
            best = off, text, trace
        if off < math.log(_CLOSE):
            break
        size *= float(np.clip(math.sqrt(strength / max(trace.strength, 1e-3)), 1e-3, 1e3))
    if best is None or best[0] > math.log(_NEAR) or best[2].retained < LEAST_RETAINED:
        return None
    return best[1], best[2]


def _bit(
    bench: Bench, rig: Rig, where: str, strength: float, beside: tuple[str, ...]
) -> tuple[str, Trace] | None:
    """The bit of a converter whose strength is nearest; None where none is near."""
    weight = abs(rig.channel(where).gain.nominal) / channel_unit(rig, where)[1]
    best: tuple[float, str, Trace] | None = None
    for bit in range(_BITS):
        text = f"{StuckBit.name}@{where}={weight * 2**bit:.8g}"
        try:
            trace = bench.trace(text, beside)
        except BadEffect:
            break  # higher than the highest
        off = abs(math.log(max(trace.strength, 1e-3) / strength))
        if best is not None and off > best[0] and trace.strength > strength:
            break
        if best is None or off < best[0]:
            best = off, text, trace
    return None if best is None or best[0] > math.log(_NEAR_BIT) else (best[1], best[2])


def _number(text: str) -> tuple[float, str]:
    """A size as nature writes it: number and percent sign."""
    bare = text.removesuffix("%")
    return float(bare), text[len(bare) :]
