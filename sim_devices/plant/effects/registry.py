"""Which effects nature can hide, and how users ask for them: ``NAME@WHERE=SIZE`` or ``random``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from recordings.rig import Rig
from sim_devices.plant.effects.effect import Effect, Request
from sim_devices.plant.effects.gain_error import GainError
from sim_devices.plant.effects.nonlinearity import Nonlinearity
from sim_devices.plant.errors import BadEffect
from sim_devices.plant.quaternion import Array
from sim_devices.plant.seeds import EFFECTS, stream

EFFECT_KINDS: Mapping[str, type[Effect]] = {kind.name: kind for kind in (GainError, Nonlinearity)}
"""Every effect by its name. A new effect is a class of its own and an entry here."""

RANDOM = "random"


def hidden_effects(
    hide: Sequence[str],
    rig: Rig,
    seed: int,
    values: Mapping[str, float],
    travel: Callable[[], Mapping[str, Array]],
) -> tuple[Effect, ...]:
    """The effects that ``hide`` asks for, in its order.

    Args:
        hide: each ``NAME@WHERE=SIZE``, or ``random`` for an effect that the seed chooses.
        rig: as described.
        seed: chooses, and shapes.
        values: true parameters, SI.
        travel: gives the values of each channel at the poses of the plan [rad or m].

    Raises:
        BadEffect: misspelled, unknown name or place, impossible size, or twice the same.
    """
    effects: list[Effect] = []
    for number, text in enumerate(hide):
        rng = stream(seed, EFFECTS, number)
        if text == RANDOM:
            taken = {(effect.name, effect.where) for effect in effects}
            choices = [
                (kind, place)
                for kind in EFFECT_KINDS.values()
                for place in kind.places(rig)
                if (kind.name, place) not in taken
            ]
            if not choices:
                raise BadEffect("there is no effect left that 'random' could choose in this rig")
            names = sorted({kind.name for kind, _ in choices})
            name = names[rng.integers(len(names))]
            places = [place for kind, place in choices if kind.name == name]
            kind, where = EFFECT_KINDS[name], places[rng.integers(len(places))]
            size = kind.typical(rig, where, rng)
        else:
            kind, where, size = _parse(text, rig)
            if any((effect.name, effect.where) == (kind.name, where) for effect in effects):
                raise BadEffect(
                    f"'{kind.name}@{where}' is hidden twice; give it once, with its whole size"
                )
        effects.append(kind.make(Request(where, size, rig, values, travel, rng)))
    return tuple(effects)


def _parse(text: str, rig: Rig) -> tuple[type[Effect], str, str]:
    head, equals, size = text.partition("=")
    name, at, where = head.strip().partition("@")
    if not (name and at and where and equals and size.strip()):
        raise BadEffect(
            f"'{text}' does not say what to hide; expected NAME@WHERE=SIZE, such as "
            f"nonlinearity@{rig.channels[-1].name}=2%, or 'random'. Names: {', '.join(EFFECT_KINDS)}"
        )
    if name not in EFFECT_KINDS:
        raise BadEffect(f"there is no effect '{name}'; expected one of: {', '.join(EFFECT_KINDS)}")
    places = EFFECT_KINDS[name].places(rig)
    if where not in places:
        raise BadEffect(
            f"'{name}' cannot sit at '{where}' in the rig '{rig.name}'; "
            f"expected one of: {', '.join(places) or '(there is no such place)'}"
        )
    return EFFECT_KINDS[name], where, size.strip()
