"""Another controller on the bus: it commands a drive that the host only listens to.

It goes round in `ROUND`: free, hold, a little further, back, off. What it says goes to the drive
and, as on any bus, to the host; so does what the drive answers. Nothing that the host sends
reaches either of them through here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sim_devices.can_bus import CanNode, Frame
from sim_devices.plant_seam import Plant

STEP_S = 1.0
"""Time between two commands."""

ROUND: Sequence[tuple[str, float]] = (
    ("off", 0.0),
    ("free", 0.0),
    ("position", 0.0),
    ("position", 1.0),
    ("position", 0.0),
)
"""Modes, and how far from where the joint was, in `STRIDE_COUNTS`."""

STRIDE_COUNTS = 200
SYNC = Frame(0x080)
REPEAT_S = 0.02

Say = Callable[[str, int], Sequence[Frame]]
"""Frames that command a mode with a target [counts]."""


class ForeignController(CanNode):
    """A controller and its one drive.

    Args:
        drive: what it commands.
        channel: channel of the rig that senses the joint.
        plant: nature, of which the controller sees the joint as everybody does.
        say: how it says a mode and a target; called again and again.
    """

    def __init__(self, drive: CanNode, channel: str, plant: Plant, say: Say) -> None:
        self._drive = drive
        self._channel = channel
        self._plant = plant
        self._say = say
        self._step = -1
        self._home = 0
        self._said_s = 0.0

    def receive(self, frame: Frame, time_s: float) -> Sequence[Frame]:
        """Whoever only listens says nothing that matters here."""
        return ()

    def tick(self, time_s: float) -> Sequence[Frame]:
        """What controller and drive say by now."""
        out = list(self._drive.tick(time_s))
        step = int(time_s / STEP_S)
        if step == self._step and time_s - self._said_s < REPEAT_S:
            return out
        mode, strides = ROUND[step % len(ROUND)]
        if step != self._step and ROUND[(step - 1) % len(ROUND)][0] != "position":
            self._home = self._plant.sense(self._channel)
        self._step, self._said_s = step, time_s
        for frame in self._say(mode, self._home + round(strides * STRIDE_COUNTS)):
            out += [frame, *self._drive.receive(frame, time_s)]
        return out


def canopen_words(node_id: int) -> Say:
    """CiA 402 by PDO: modes by RPDO1, set-points by RPDO2; the drive is started first."""
    last: list[tuple[str, int]] = []

    def say(mode: str, target: int) -> Sequence[Frame]:
        if not last:
            last[:] = [("", 0)]
            return [Frame(0x000, bytes([0x01, node_id]))]
        if last == [(mode, target)]:
            # It repeats what is cyclic, as controllers do, and commands nothing by it.
            return [_rpdo1(node_id, 0x0F if mode != "off" else 0x00, _operation(mode)), SYNC]
        last[:] = [(mode, target)]
        if mode == "off":
            return [_rpdo1(node_id, 0x00, 0), SYNC]
        frames = [_rpdo1(node_id, word, _operation(mode)) for word in (0x06, 0x07, 0x0F)]
        if mode == "position":
            frames += [_rpdo2(node_id, word, target) for word in (0x0F, 0x1F)]
        return [*frames, SYNC]

    return say


def _operation(mode: str) -> int:
    return {"off": 0, "free": 4, "torque": 4, "position": 1}[mode]


def _rpdo1(node_id: int, control: int, operation: int) -> Frame:
    return Frame(0x200 + node_id, control.to_bytes(2, "little") + bytes([operation]))


def _rpdo2(node_id: int, control: int, target: int) -> Frame:
    data = control.to_bytes(2, "little") + target.to_bytes(4, "little", signed=True)
    return Frame(0x300 + node_id, data)
