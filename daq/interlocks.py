"""Interlocks: whether a plan, a mode, a target or a torque is allowed, and whether what is seen is.

Owns the judgement, in words. Pure: what is asked and what was measured in, reasons out. Who
refuses the command, or makes the session safe, is `daq.drives` and `daq.guard`.

Measured travel is the median of the last samples, measured speed the change between the
medians of two halves of a short window: one or two wild samples move neither. Both are held
against their limit with a margin of `CONFIDENCE` standard deviations of their noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.clock import SECOND
from daq.mobility import Mobility
from daq.scale import Scale, scale_of
from daq.standstill import CONFIDENCE, Window, noise_of
from recordings.events import Mode
from recordings.rig import JointInterlock, Plan, Range, Rig, Visit

SPEED_S = 0.1
"""Time over which speed is measured [s]; longer where fewer than `FEWEST` samples fall in it."""

FEWEST = 6
"""Samples from which speed is measured, at least."""

TARGETS_S = 0.25
"""Two targets count as at most this far apart in time [s]: a pause does not allow a jump."""

UNEVEN_S = 0.1
"""By how much the times at which targets are sent may scatter [s]."""

PERMILLE = 1000.0


class Interlocks:
    """The interlocks of one rig.

    Args:
        rig: its description.
        mobility: of its mechanism.
    """

    def __init__(self, rig: Rig, mobility: Mobility) -> None:
        self._rig = rig
        self._mobility = mobility
        self._limits = {place: _limits(rig, place) for place in rig.mechanism.places}
        self._scales = {
            place: scale_of(rig, place)
            for place in rig.mechanism.places
            if rig.sensed_by(place) is not None
        }

    def of_plan(self, plan: Plan, stops: Sequence[Visit]) -> tuple[str, ...]:
        """Everything in ``plan`` that an interlock would refuse, before anything is moved."""
        drives = plan.drives
        found = [self._mobility.fights(drives)] if drives else []
        held = dict.fromkeys(drives, Mode.POSITION)
        others = {d.joint: Mode.FREE for d in self._rig.devices if d.joint is not None}
        modes = others | held
        found += [self._of_mode(joint, mode, modes) for joint, mode in modes.items()]
        for joint in drives:
            speed = self._limits[joint].speed
            if speed is not None and plan.move > speed:
                found.append(
                    f"the plan moves {joint} with {plan.move:g} per s, its limit is {speed:g} (rad or m)"
                )
        for visit in stops:
            for joint, target in zip(drives, visit.targets, strict=True):
                if outside := self._outside(joint, target):
                    found.append(f"pose {visit.pose} takes {outside}")
        return tuple(dict.fromkeys(text for text in found if text))

    def of_mode(self, joint: str, mode: Mode, modes: Mapping[str, Mode]) -> str:
        """Why ``joint`` must not be told ``mode`` while all drives are in ``modes``; "" where it may.

        Args:
            joint: whom the command is for.
            mode: what it would be told.
            modes: what each drive is taken to be in, in the worst case.
        """
        if mode is Mode.OFF:
            return ""
        after = {**modes, joint: mode}
        if mode is Mode.POSITION:
            held = {name for name, each in after.items() if each is Mode.POSITION}
            if fights := self._mobility.fights(held):
                return fights
        return self._of_mode(joint, mode, after)

    def of_target(self, joint: str, target: float, last: float, seconds: float) -> str:
        """Why ``joint`` must not be sent to ``target`` [rad or m], ``seconds`` after ``last``; "" where it may."""
        if outside := self._outside(joint, target):
            return outside
        speed = self._limits[joint].speed
        if speed is None:
            return ""
        scale = self._scales[joint]
        way = abs(scale.away(target, last))
        if way <= speed * (min(seconds, TARGETS_S) + UNEVEN_S) + abs(scale.gain):
            return ""
        return (
            f"{joint} would be led by {way:.3g} {seconds:.2f} s after its last target, its limit is "
            f"{speed:g} per s (rad or m)"
        )

    def of_torque(self, joint: str, permille: int) -> str:
        """Why ``joint`` must not push with ``permille`` of its rated torque; "" where it may."""
        limit = self._limits[joint].torque or 0.0
        if abs(permille) <= PERMILLE * limit:
            return ""
        return (
            f"{joint} was to push with {permille / 10:g} % of its rated torque, its limit is "
            f"{100 * limit:g} % (torque_percent)"
        )

    def of_motion(self, windows: Mapping[str, Window], latest: Mapping[str, int]) -> dict[str, str]:
        """What is seen to be outside its limits, by joint, in words.

        Args:
            windows: by channel, the newest samples, for at least `SPEED_S` and `FEWEST`.
            latest: by channel, the raw count of the newest sample.
        """
        found = {}
        for joint, scale in self._scales.items():
            window = windows.get(scale.channel)
            if window is None or len(window.counts) < FEWEST:
                continue
            limits = self._limits[joint]
            stated = self._rig.channel(scale.channel).noise
            if too_far := _too_far(limits.travel, scale, window, latest[scale.channel], stated):
                found[joint] = f"{joint} stands at {too_far}"
            elif limits.speed is not None and (
                too_fast := _too_fast(limits.speed, scale, window, stated)
            ):
                found[joint] = f"{joint} moves with {too_fast}"
        return found

    def _of_mode(self, joint: str, mode: Mode, modes: Mapping[str, Mode]) -> str:
        word = mode.name.lower()
        if mode is not Mode.OFF and word not in self._limits[joint].modes:
            return (
                f"{joint} must not be in mode '{word}'; the interlocks allow: "
                f"{', '.join(self._limits[joint].modes)}"
            )
        for rule in self._rig.interlocks.together:
            if rule.mode != word or joint not in rule.joints:
                continue
            there = [name for name in rule.joints if modes.get(name) is mode]
            if len(there) > rule.at_most:
                return (
                    f"{', '.join(there)} would be in mode '{word}' together; the interlocks allow "
                    f"{rule.at_most} of {', '.join(rule.joints)}"
                )
        return ""

    def _outside(self, joint: str, value: float) -> str:
        outside = _outside(self._limits[joint].travel, value, 0.0)
        return f"{joint} to {outside}" if outside else ""


def _limits(rig: Rig, place: str) -> JointInterlock:
    """What the interlocks say of ``place``; its travel is that of the joint where they say none."""
    said = rig.interlocks.of(place)
    joints = {joint.name: joint for joint in getattr(rig.mechanism, "joints", ())}
    if said.travel is None and place in joints:
        return said.model_copy(update={"travel": joints[place].limits})
    return said


def _outside(travel: Range | None, value: float, margin: float) -> str:
    if travel is None or travel.low - margin <= value <= travel.high + margin:
        return ""
    return f"{value:.6g}, outside its travel [{travel.low:.6g}, {travel.high:.6g}] (rad or m)"


def _too_far(travel: Range | None, scale: Scale, window: Window, latest: int, stated: float) -> str:
    """Where a joint is seen, if that is outside ``travel`` by more than noise."""
    counts = window.counts[-FEWEST:]
    here = scale.value(latest + _median(counts) - float(counts[-1]))
    if not _outside(travel, here, 0.0):
        return ""
    return _outside(travel, here, CONFIDENCE * abs(scale.gain) * noise_of(window, stated))


def _too_fast(limit: float, scale: Scale, window: Window, stated: float) -> str:
    """How fast a joint is seen to move, if that is above ``limit`` by more than noise."""
    first = int(np.searchsorted(window.time_ns, int(window.time_ns[-1]) - round(SPEED_S * SECOND)))
    half = max(FEWEST, len(window.counts) - first) // 2
    early, late = slice(-2 * half, -half), slice(-half, None)
    seconds = float(np.mean(window.time_ns[late] - window.time_ns[early])) / SECOND
    if seconds <= 0.0:
        return ""
    way = abs(scale.gain * (_median(window.counts[late]) - _median(window.counts[early])))
    speed = way / seconds
    if speed <= limit:
        return ""
    # The median of n normal samples scatters by sqrt(pi / 2 n); this is the difference of two.
    error = abs(scale.gain) * noise_of(window, stated) * math.sqrt(math.pi / half) / seconds
    if speed <= limit + CONFIDENCE * error:
        return ""
    return f"{speed:.3g} per s, its limit is {limit:g} (rad or m)"


def _median(counts: NDArray[np.int64]) -> float:
    ordered = sorted(counts.tolist())
    middle = len(ordered) // 2
    return 0.5 * float(ordered[middle] + ordered[~middle])
