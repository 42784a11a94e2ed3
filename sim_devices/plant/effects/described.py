"""Reading the values of an effect that the rig describes, as `docs/formats.md` lists them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from recordings.rig import DescribedEffect, Rig
from recordings.rig.quantity import SHOWN
from sim_devices.plant.errors import BadEffect


def read_values(
    effect: DescribedEffect,
    values: Mapping[str, float],
    coefficients: Mapping[str, str],
    settings: Mapping[str, str] | None = None,
) -> dict[str, float]:
    """True values of an effect, SI, by name; coefficients that the rig leaves out are 0.

    Args:
        effect: as described.
        values: true parameters, SI, by name.
        coefficients: dimension of each; at least one is given, unless there are none.
        settings: dimension of each; all are given.

    Raises:
        BadEffect: a value is unknown, missing, or of another dimension.
    """
    settings = settings or {}
    known = {**coefficients, **settings}
    listed = [f"{part} ({dimension})" for part, dimension in known.items()]
    expected = ", ".join(listed if len(listed) < 10 else [*listed[:3], "...", *listed[-2:]])
    for part, quantity in effect.values.items():
        if part not in known:
            raise BadEffect(
                f"the effect '{effect.label}' of the rig has the value '{part}', expected: {expected}"
            )
        if quantity.dimension != known[part]:
            raise BadEffect(
                f"'{part}' of the effect '{effect.label}' is given as {quantity.dimension}, "
                f"expected {known[part]}"
            )
    for part in settings:
        if part not in effect.values:
            raise BadEffect(f"the effect '{effect.label}' of the rig has no '{part}'; give it")
    if coefficients and not any(part in effect.values for part in coefficients):
        raise BadEffect(
            f"the effect '{effect.label}' of the rig has none of its coefficients: "
            f"{', '.join(list(coefficients)[:6])}; give at least one"
        )
    return {part: values.get(f"{effect.label}.{part}", 0.0) for part in known}


def check_place(effect: DescribedEffect, places: Sequence[str]) -> None:
    """Raises BadEffect where the effect sits at none of ``places``."""
    if effect.where not in places:
        raise BadEffect(
            f"the rig describes '{effect.label}', but '{effect.name}' cannot sit at '{effect.where}'; "
            f"expected one of: {', '.join(places) or '(there is no such place in this rig)'}"
        )


def channel_names(rig: Rig) -> tuple[str, ...]:
    """All channels."""
    return tuple(channel.name for channel in rig.channels)


def channel_dimension(rig: Rig, channel: str) -> str:
    """ "angle" or "length"."""
    return rig.dimension_of(rig.channel(channel).senses)


def told(dimension: str, value: float) -> tuple[float, str]:
    """An SI value as it is told, with its unit."""
    unit, to_si = SHOWN[dimension]
    return value / to_si, unit
