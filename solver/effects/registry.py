"""Which effects the solver knows: its own, and those that installed packages add.

A package adds effects under the entry point group ``loopcal.effects``: each entry leads to a
subclass of `Effect`. A name that is taken already is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points

from solver.effects.axis_offset import AxisOffset
from solver.effects.backlash import Backlash
from solver.effects.bearing_compliance import BearingCompliance
from solver.effects.crosstalk import Crosstalk
from solver.effects.effect import Effect
from solver.effects.fixture import FixtureCompliance, FixtureSlip
from solver.effects.gain_error import GainError
from solver.effects.joint_compliance import JointCompliance
from solver.effects.lag import Lag
from solver.effects.link_geometry import LinkGeometry
from solver.effects.nonlinearity import Nonlinearity
from solver.effects.offset_drift import OffsetDrift
from solver.effects.offset_jump import OffsetJump
from solver.effects.periodic import CyclicError, Eccentricity
from solver.effects.saturation import Saturation
from solver.effects.stuck_bit import StuckBit
from solver.effects.thermal_growth import ThermalGrowth
from solver.errors import MechanismError

GROUP = "loopcal.effects"

BUILT_IN: tuple[type[Effect], ...] = (
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


@cache
def effect_kinds() -> Mapping[str, type[Effect]]:
    """Every effect by its name, built-in ones first.

    Raises:
        MechanismError: a package's entry is no effect, or its name is taken.
    """
    kinds: dict[str, type[Effect]] = {kind.name: kind for kind in BUILT_IN}
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        kind = entry.load()
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise MechanismError(
                f"the entry '{entry.name}' of group '{GROUP}' leads to {kind!r}, expected a subclass of Effect"
            )
        if kind.name in kinds:
            raise MechanismError(
                f"the effect '{kind.name}' of '{entry.value}' has a name that is taken already"
            )
        kinds[kind.name] = kind
    return kinds
