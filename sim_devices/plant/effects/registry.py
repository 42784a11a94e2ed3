"""Which effects nature can hide, and how users ask for them: ``NAME@WHERE=SIZE`` or ``random``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from recordings.rig import Rig
from sim_devices.plant.effects.axis_offset import AxisOffset
from sim_devices.plant.effects.backlash import Backlash
from sim_devices.plant.effects.bearing_compliance import BearingCompliance
from sim_devices.plant.effects.crosstalk import Crosstalk
from sim_devices.plant.effects.cyclic_error import CyclicError
from sim_devices.plant.effects.eccentricity import Eccentricity
from sim_devices.plant.effects.effect import Effect, Request, Rests
from sim_devices.plant.effects.fixture_compliance import FixtureCompliance
from sim_devices.plant.effects.fixture_slip import FixtureSlip
from sim_devices.plant.effects.gain_error import GainError
from sim_devices.plant.effects.joint_compliance import JointCompliance
from sim_devices.plant.effects.lag import Lag
from sim_devices.plant.effects.link_geometry import LinkGeometry
from sim_devices.plant.effects.nonlinearity import Nonlinearity
from sim_devices.plant.effects.offset_drift import OffsetDrift
from sim_devices.plant.effects.offset_jump import OffsetJump
from sim_devices.plant.effects.outsiders.bending_leg import BendingLeg
from sim_devices.plant.effects.outsiders.creep import Creep
from sim_devices.plant.effects.outsiders.product_error import ProductError
from sim_devices.plant.effects.outsiders.swinging_offset import SwingingOffset
from sim_devices.plant.effects.outsiders.wobbling_axis import WobblingAxis
from sim_devices.plant.effects.saturation import Saturation
from sim_devices.plant.effects.stuck_bit import StuckBit
from sim_devices.plant.effects.thermal_growth import ThermalGrowth
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.seeds import EFFECTS, stream

_CATALOGUE: tuple[type[Effect], ...] = (
    GainError,
    Nonlinearity,
    Eccentricity,
    CyclicError,
    Backlash,
    OffsetDrift,
    OffsetJump,
    Lag,
    Crosstalk,
    StuckBit,
    Saturation,
    JointCompliance,
    BearingCompliance,
    FixtureCompliance,
    FixtureSlip,
    LinkGeometry,
    AxisOffset,
    ThermalGrowth,
)

EFFECT_KINDS: Mapping[str, type[Effect]] = {kind.name: kind for kind in _CATALOGUE}
"""Every effect by its name. A new effect is a class of its own and an entry here."""

OUTSIDER_KINDS: Mapping[str, type[Effect]] = {
    kind.name: kind for kind in (Creep, SwingingOffset, ProductError, WobblingAxis, BendingLeg)
}
"""Effects outside the catalogue, by their names with ``outsider:``; never drawn."""

RANDOM = "random"


def hidden_effects(
    hide: Sequence[str],
    rig: Rig,
    seed: int,
    values: Mapping[str, float],
    rests: Callable[[], Rests],
) -> tuple[Effect, ...]:
    """The effects that ``hide`` asks for, in its order.

    Args:
        hide: each ``NAME@WHERE=SIZE``, or ``random`` for an effect that the seed chooses.
        rig: as described.
        seed: chooses, and shapes.
        values: true parameters, SI.
        rests: gives the stops of the plan.

    Raises:
        BadEffect: misspelled, unknown name or place, impossible size, or twice the same.
    """
    effects: list[Effect] = []
    for number, text in enumerate(hide):
        rng = stream(seed, EFFECTS, number)
        if text == RANDOM:
            taken = {(effect.name, effect.where) for effect in effects}
            effects.append(_random(Request("", "", rig, values, rests, rng), taken))
        else:
            kind, where, size = _parse(text, rig)
            if any((effect.name, effect.where) == (kind.name, where) for effect in effects):
                raise BadEffect(
                    f"'{kind.name}@{where}' is hidden twice; give it once, with its whole size"
                )
            effects.append(kind.make(Request(where, size, rig, values, rests, rng)))
    return tuple(effects)


def _random(request: Request, taken: set[tuple[str, str]]) -> Effect:
    """An effect of any name alike, at any of its places; ``request`` without place and size."""
    rig, rng = request.rig, request.rng
    choices = {
        name: [place for place in kind.places(rig) if (name, place) not in taken]
        for name, kind in EFFECT_KINDS.items()
    }
    while names := sorted(name for name, places in choices.items() if places):
        name = names[rng.integers(len(names))]
        where = choices[name][rng.integers(len(choices[name]))]
        size = EFFECT_KINDS[name].typical(rig, where, rng)
        try:
            return EFFECT_KINDS[name].make(replace(request, where=where, size=size))
        except BadEffect:
            # What is typical elsewhere does not fit here, such as an error of a disc that hardly turns.
            choices[name].remove(where)
    raise BadEffect("there is no effect left that 'random' could choose in this rig")


def described_effects(rig: Rig, values: Mapping[str, float]) -> tuple[Effect, ...]:
    """The effects that ``rig`` describes, in its order.

    Args:
        rig: as described.
        values: true parameters, SI, the values of its effects among them.

    Raises:
        BadEffect: an effect that nature does not know, or that cannot be so.
    """
    out = []
    for effect in rig.effects:
        if effect.name not in EFFECT_KINDS:
            raise BadEffect(
                f"the rig describes '{effect.label}', but nature knows no effect '{effect.name}'; "
                f"expected one of: {', '.join(EFFECT_KINDS)}"
            )
        out.append(EFFECT_KINDS[effect.name].described(effect, rig, values))
    return tuple(out)


def _parse(text: str, rig: Rig) -> tuple[type[Effect], str, str]:
    head, equals, size = text.partition("=")
    name, at, where = head.strip().partition("@")
    if not (name and at and where and equals and size.strip()):
        raise BadEffect(
            f"'{text}' does not say what to hide; expected NAME@WHERE=SIZE, such as "
            f"nonlinearity@{rig.channels[-1].name}=2%, or 'random'. Names: {', '.join(EFFECT_KINDS)}"
        )
    kinds = OUTSIDER_KINDS if name.startswith("outsider:") else EFFECT_KINDS
    if name not in kinds:
        raise BadEffect(f"there is no effect '{name}'; expected one of: {', '.join(kinds)}")
    places = kinds[name].places(rig)
    if where not in places:
        raise BadEffect(
            f"'{name}' cannot sit at '{where}' in the rig '{rig.name}'; "
            f"expected one of: {', '.join(places) or '(there is no such place)'}"
        )
    return kinds[name], where, size.strip()
