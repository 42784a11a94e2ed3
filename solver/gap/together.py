"""Several sessions of one rig as one recording: what a gap analysis of more poses starts from.

Sessions are laid end to end on one time axis, in the order given, whatever the clock said between
them. A moment keeps its place on that axis: what jumped in the first session stays where it went,
and something may have changed between two sessions. What drifts starts anew in each session,
whose beginnings the joined recording keeps (`Recording.session_starts_ns`). Gains, zeros and
geometry are the same throughout, unless an effect says otherwise.

Owns the joining. Refuses sessions of different rigs; plans may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from recordings.events import ClockSample, Dwell, Fault, Mark, ModeCommand, ModeReport
from recordings.reader import Recording
from recordings.recording import Readings
from recordings.rig import Rig
from solver.errors import NotEnoughData

_BETWEEN_NS = 1_000_000_000
_E = TypeVar("_E", Mark, Fault, ModeCommand, ModeReport, ClockSample)


def together(recordings: Sequence[Recording]) -> Recording:
    """One recording of all sessions; the first one itself where there is no other.

    Args:
        recordings: of one rig, in order of time; the first gives the rig and the session's data.

    Raises:
        NotEnoughData: a recording is of another rig than the first, or has dwells where
            another has none.
    """
    joined = recordings[0]
    for recording in recordings[1:]:
        _require_same_rig(recordings[0], recording)
        joined = _joined(joined, recording)
    return joined


def _require_same_rig(first: Recording, other: Recording) -> None:
    if _unplanned(first.rig) == _unplanned(other.rig):
        return
    if first.rig.name != other.rig.name:
        how = f"it is of rig '{other.rig.name}', and '{first.path}' of rig '{first.rig.name}'"
    else:
        mine, others = _unplanned(first.rig).model_dump(), _unplanned(other.rig).model_dump()
        parts = ", ".join(key for key in mine if mine[key] != others[key])
        how = f"its rig '{other.rig.name}' differs from that of '{first.path}' in: {parts}"
    raise NotEnoughData(
        f"'{other.path}' cannot be analysed together with '{first.path}': {how}. "
        "Give recordings of one and the same rig."
    )


def _unplanned(rig: Rig) -> Rig:
    return rig.model_copy(update={"plan": None})


def _joined(first: Recording, second: Recording) -> Recording:
    """``second`` behind ``first``."""
    if bool(first.dwells) != bool(second.dwells):
        with_dwells, without = (first, second) if first.dwells else (second, first)
        raise NotEnoughData(
            f"'{with_dwells.path}' says when the mechanism stood still and '{without.path}' does not; "
            "such recordings cannot be analysed together"
        )
    later = _last_ns(first) + _BETWEEN_NS - second.session.start_ns
    poses = 1 + max((d.pose for d in first.dwells), default=-1)
    return replace(
        first,
        readings={
            name: _behind(readings, second.readings[name], later)
            for name, readings in first.readings.items()
        },
        dwells=(
            *first.dwells,
            *(
                Dwell(
                    d.time_ns + later,
                    d.start_ns + later,
                    d.end_ns + later,
                    d.pose + poses,
                    d.visit,
                    d.fixture,
                )
                for d in second.dwells
            ),
        ),
        marks=(*first.marks, *_later(second.marks, later)),
        faults=(*first.faults, *_later(second.faults, later)),
        mode_commands=(*first.mode_commands, *_later(second.mode_commands, later)),
        mode_reports=(*first.mode_reports, *_later(second.mode_reports, later)),
        clock=(*first.clock, *_later(second.clock, later)),
        damage=(*first.damage, *second.damage),
        session_starts_ns=(
            *(first.session_starts_ns or (first.session.start_ns,)),
            second.session.start_ns + later,
        ),
    )


def _last_ns(recording: Recording) -> int:
    ends = [int(r.time_ns[-1]) for r in recording.readings.values() if len(r)]
    return max([recording.session.start_ns, *ends, *(d.end_ns for d in recording.dwells)])


def _later(events: tuple[_E, ...], by_ns: int) -> tuple[_E, ...]:
    return tuple(replace(event, time_ns=event.time_ns + by_ns) for event in events)


def _behind(first: Readings, second: Readings, later: int) -> Readings:
    """Readings of one channel; sample counters do not go on from one session to the next."""
    host = second.time_ns + later
    device: NDArray[np.int64] | None = None
    if first.device_time_ns is not None and second.device_time_ns is not None:
        device = np.concatenate([first.device_time_ns, _continued(first, second, host)])
    return Readings(
        first.channel,
        np.concatenate([first.time_ns, host]),
        np.concatenate([first.raw, second.raw]),
        device,
        None,
        np.concatenate([first.flags, second.flags]),
    )


def _continued(first: Readings, second: Readings, host: NDArray[np.int64]) -> NDArray[np.int64]:
    """The device's times of ``second`` on its clock of ``first``, as if it had gone on."""
    before, now = first.device_time_ns, second.device_time_ns
    assert before is not None
    assert now is not None
    if len(before) < 2 or not len(now):
        return np.asarray(now + (host[0] - now[0] if len(now) else 0))
    # Device time as a line of host time, both from their first value: they differ by parts in 10^5.
    since = (first.time_ns - first.time_ns[0]).astype(np.float64)
    run = (before - before[0]).astype(np.float64)
    spread = since - since.mean()
    rate = float(spread @ run) / max(float(spread @ spread), 1.0)
    level = float(run.mean() - rate * since.mean())
    expected = level + rate * (host - first.time_ns[0]).astype(np.float64)
    shift = float(np.median(expected - (now - now[0]).astype(np.float64)))
    return np.asarray(now - now[0] + before[0] + round(shift))
