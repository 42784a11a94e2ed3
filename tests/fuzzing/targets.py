"""Everything that is fuzzed, as one table. A new driver adds its targets here."""

from __future__ import annotations

from tests.fuzzing import (
    can_targets,
    file_targets,
    modbus_targets,
    recording_targets,
    stream_targets,
)
from tests.fuzzing.target import Target

TARGETS: tuple[Target, ...] = (
    *recording_targets.TARGETS,
    *file_targets.TARGETS,
    *can_targets.TARGETS,
    *modbus_targets.TARGETS,
    *stream_targets.TARGETS,
)
