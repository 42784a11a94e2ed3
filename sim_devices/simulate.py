"""A recording without wires: nature plays a whole session, and a file like a capture's is written.

Same topics, same kinds of events and same order of things as a capture of the rig's plan:
readings of every channel at the plan's rate with a little jitter of arrival, mode commands
and reports of the drives, a dwell for every pose reached, a fault for every one that was
not, and the ledger. A rig with several fixtures is played fixture by fixture, and every dwell
names its own. By hand there are no dwells: whoever reads the file finds them.

The same rig, poses, seed and effects give the same bytes: the session begins at `EPOCH_NS`,
whenever it is run. Truth goes to a file of its own or nowhere.
"""

from __future__ import annotations

import uuid
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.events import Dwell, Event, Fault, Mark, Mode, ModeCommand, ModeReport
from recordings.rig import Plan, Rig, SerialMechanism
from recordings.session import Session
from recordings.writer import Writer
from sim_devices.plant.creation import make_nature
from sim_devices.plant.errors import CannotSimulate
from sim_devices.plant.nature import Nature
from sim_devices.plant.noise import Noise
from sim_devices.plant.seeds import ARRIVAL, NOISE, SESSION, stream
from sim_devices.plant.session import Played, plan_of, play
from sim_devices.plant.stop import Stop
from sim_devices.truth import Truth, refuse_to_overwrite, write_truth

EPOCH_NS = 1_735_689_600_000_000_000
"""Start of every simulated session: 2025-01-01T00:00:00 UTC."""

_LATENCY_S = 0.8e-3
_JITTER_S = 0.15e-3
"""A reading arrives this long after its sample: a constant, and the mean of an exponential."""
_CLOCK_RATE = 20e-6
"""Standard deviation of the rates of device clocks."""
_ENABLED = 0x0237
_TARGET_REACHED = 0x0400
_FAULT = 0x0218
"""CiA 402 status words: operation enabled by remote, at its target, fault."""


def simulate(
    rig: Rig,
    rig_toml: str,
    path: str | Path,
    *,
    poses: int | None = None,
    seed: int = 1,
    hide: Sequence[str] = (),
    truth_path: str | Path | None = None,
    noise: Noise | None = None,
    plan: Plan | None = None,
) -> Truth:
    """Write the recording of a simulated session.

    Args:
        rig: as described.
        rig_toml: its text, which the recording carries.
        path: file to create.
        poses: number of distinct poses (in each fixture), in place of the plan's own.
        seed: of all that is random, 0 or above.
        hide: effects at work, each ``NAME@WHERE=SIZE`` or ``random``.
        truth_path: file to create with the truth, or None.
        noise: of the readings; by default white and normal.
        plan: what is played in place of the rig's own plan, by the same nature: effects that are
            sized by the plan's travel are sized by the rig's own. It is another session, so its
            noise is drawn anew (the same plan gives the same).

    Returns:
        What the rig really was.

    Raises:
        BadEffect: an effect that is misspelled or cannot be.
        CannotSimulate: no plan, or one that this mechanism cannot carry out.
        MechanismDoesNotClose: the loop does not close.
        RecordingError: the recording exists already or cannot be written.
        TruthNotWritten: the truth file exists already or cannot be written.
    """
    if poses is not None and poses < 1:
        raise CannotSimulate(f"{poses} poses were asked for, expected at least 1")
    if truth_path is not None:
        refuse_to_overwrite(truth_path)
    nature = make_nature(rig, seed, hide, poses if plan is None else None)
    drawn = seed
    if plan is not None:
        nature = replace(nature, rig=rig.model_copy(update={"plan": plan}))
        drawn = zlib.crc32(f"{seed} {plan.model_dump_json()}".encode())
    played = play(nature, poses)
    session = Session(
        session_id=str(uuid.UUID(bytes=stream(drawn, SESSION).bytes(16), version=4)),
        start_ns=EPOCH_NS,
        operator="simulated",
        notes="simulated without wires",
    )
    with Writer(path, rig_toml, session) as writer:
        _write(writer, nature, played, noise or Noise(), drawn)
    if truth_path is not None:
        write_truth(nature.truth, truth_path)
    return nature.truth


def _write(writer: Writer, nature: Nature, played: Played, noise: Noise, seed: int) -> None:
    """All events, a stretch of readings and then what happened at its end, stop by stop.

    ``seed`` is that of the noise.
    """
    time_s = played.course.time_s
    arrivals = _arrivals(nature, time_s)
    readings = []
    for k, channel in enumerate(nature.rig.channels):
        rng = stream(seed, NOISE, k)
        off = noise.samples(rng, len(time_s))
        off = off + noise.of_visits(seed, k, time_s, played.stops, plan_of(nature))
        raw = nature.sensors[channel.name].counts(played.course, rng, off)
        readings.append((channel.name, raw, *arrivals[channel.device or channel.name]))
    for event in _setting_out(nature):
        writer.write(event)
    sequence = np.arange(len(time_s)) % 2**32
    begin = 0
    before: Stop | None = None
    for stop in (*played.stops, None):
        end = len(time_s) if stop is None else int(np.searchsorted(time_s, stop.leave_s))
        if stop is not None:
            if before is not None and before.fixture != stop.fixture:
                for event in _carried(before, stop):
                    writer.write(event)
            for event in _moving(stop):
                writer.write(event)
            before = stop
        for name, raw, host_ns, device_ns in readings:
            part = slice(begin, end)
            writer.write_readings(name, host_ns[part], raw[part], device_ns[part], sequence[part])
        if stop is not None:
            for event in _standing(stop, bool(plan_of(nature).drives)):
                writer.write(event)
        begin = end
    for name, raw, *_ in readings:
        writer.account(name, expected=len(raw))


def _arrivals(
    nature: Nature, time_s: NDArray[np.float64]
) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """For each device, when its samples arrive at the host, and when they were by its own clock [ns].

    Channels of one device arrive together; a device's clock began when it was switched on.
    """
    out = {}
    sources = dict.fromkeys(c.device or c.name for c in nature.rig.channels)
    for k, source in enumerate(sources):
        rng = stream(nature.truth.seed, ARRIVAL, k)
        late = _LATENCY_S + rng.exponential(_JITTER_S, len(time_s))
        host = EPOCH_NS + np.rint((time_s + late) * 1e9).astype(np.int64)
        switched_on = rng.uniform(5.0, 300.0)
        device = switched_on + time_s * (1.0 + _CLOCK_RATE * rng.standard_normal())
        out[source] = (np.maximum.accumulate(host), np.rint(device * 1e9).astype(np.int64))
    return out


def _ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)


def _setting_out(nature: Nature) -> Iterator[Event]:
    """Joints with a drive: those of the plan are engaged by their first target, the others free."""
    if not isinstance(nature.rig.mechanism, SerialMechanism):
        return
    plan = plan_of(nature)
    for device in nature.rig.devices:
        if device.joint is not None and device.joint not in plan.drives:
            yield ModeCommand(device.joint, EPOCH_NS, Mode.FREE, None, "plan")
            yield ModeReport(device.joint, EPOCH_NS, Mode.FREE, _ENABLED)


def _carried(before: Stop, stop: Stop) -> Iterator[Event]:
    """The endpoint is taken out of one fixture and put into the next, by hand."""
    left_ns = _ns(before.leave_s)
    for joint in before.targets:
        yield ModeCommand(joint, left_ns, Mode.FREE, None, "change of fixture")
        yield ModeReport(joint, left_ns, Mode.FREE, _ENABLED)
    yield Mark(left_ns, f"the endpoint goes from fixture '{before.fixture}' to '{stop.fixture}'")


def _moving(stop: Stop) -> Iterator[Event]:
    for joint, raw in stop.targets.items():
        cause = f"pose {stop.pose}, visit {stop.visit}"
        yield ModeCommand(joint, _ns(stop.start_s), Mode.POSITION, raw, cause)


def _standing(stop: Stop, driven: bool) -> Iterator[Event]:
    for joint in stop.targets:
        code = stop.faults.get(joint, 0)
        mode, status = (Mode.FAULT, _FAULT) if code else (Mode.POSITION, _ENABLED | _TARGET_REACHED)
        yield ModeReport(joint, _ns(stop.arrive_s), mode, status, code)
        if code:
            text = f"the drive of {joint} did not reach pose {stop.pose} (error 0x{code:04X})"
            yield Fault(_ns(stop.arrive_s), joint, "drive", text)
    if driven and not stop.faults:
        end = _ns(stop.leave_s)
        yield Dwell(end, _ns(stop.rest_s), end, stop.pose, stop.visit, stop.fixture)
