"""Nature behind sensors that can get stuck: a held channel keeps the count that it has."""

from __future__ import annotations

from collections.abc import Collection

from sim_devices.plant_seam import Plant


class StuckPlant:
    """``plant``, except for channels that are held. See `sim_devices.plant_seam.Plant`."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._held: dict[str, int] = {}

    def hold(self, channels: Collection[str]) -> None:
        """Hold these channels, and no others; those that are held already keep their counts."""
        held = {c: self._held[c] for c in channels if c in self._held}
        self._held = held | {c: self._plant.sense(c) for c in channels if c not in held}

    def advance(self, time_s: float) -> None:
        """Move nature to this time."""
        self._plant.advance(time_s)

    def sense(self, channel: str) -> int:
        """Raw counts of a channel now."""
        return self._held[channel] if channel in self._held else self._plant.sense(channel)

    def command(self, joint: str, mode: str, target_raw: int) -> None:
        """What the drive of ``joint`` does from now on."""
        self._plant.command(joint, mode, target_raw)

    def drive_fault(self, joint: str) -> int:
        """Error code of what the joint does to its drive now."""
        return self._plant.drive_fault(joint)
