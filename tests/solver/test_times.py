"""When samples were taken: by clocks that the session measured, and by round trips that bound them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recordings.events import ClockSample, RoundTrip
from recordings.reader import read_recording
from recordings.recording import Readings, Recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.motion import with_motion
from solver.samples import average
from solver.times import taken

RIG = load_rig("arm")
COUNT = 3000
STEP_NS = 10_000_000
DRIFT = 30e-6


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("times") / "arm.mcap"
    simulate(RIG, rig_text("arm")[0], path, poses=6, seed=2)
    return read_recording(path)


def instants(recording: Recording) -> np.ndarray:
    """True times of the samples made up here [ns]."""
    return recording.session.start_ns + np.arange(COUNT) * STEP_NS


def made_up(recording: Recording, channel: str, floor_ns: int, *, clock: bool) -> Recording:
    """``channel`` with known delays: a floor, a tail, and spells of 30 ms; its clock is known or not."""
    rng = np.random.default_rng(4)
    true = instants(recording)
    late = floor_ns + rng.exponential(1e6, COUNT) + 30e6 * (np.arange(COUNT) % 500 > 450)
    host = np.maximum.accumulate(true + late.astype(np.int64))
    device = np.rint((true - true[0]) / (1.0 + DRIFT)).astype(np.int64) + 7_000_000_000
    known = []
    for at in range(99, COUNT, 100) if clock else ():
        offset = int(true[at]) + floor_ns - int(device[at])
        known.append(
            ClockSample("wrist-adc", int(host[at]), int(device[at]), offset, 5_000, 30_000, 10)
        )
    readings = Readings(
        channel,
        host,
        np.zeros(COUNT, np.int64),
        device if clock else None,
        np.arange(COUNT, dtype=np.uint32),
        np.zeros(COUNT, np.uint32),
    )
    return replace(
        recording, readings={**recording.readings, channel: readings}, clock=tuple(known)
    )


def asked(recording: Recording, shortest_ns: int, longest_ns: int) -> Recording:
    trips = (RoundTrip("wrist-adc", recording.session.start_ns, shortest_ns, longest_ns),)
    return replace(recording, round_trips=trips)


def test_a_known_clock_takes_off_every_wait(simulated: Recording) -> None:
    recording = made_up(simulated, "q6", 2_000_000, clock=True)
    found = taken(recording, RIG.channel("q6"), recording.session.start_ns)
    off_s = found.time_s - (instants(recording) - recording.session.start_ns) * 1e-9
    assert off_s == pytest.approx(2e-3, abs=20e-6)
    assert found.uncertainty_s == pytest.approx(5e-6)


@pytest.mark.parametrize("clock", [True, False])
def test_a_round_trip_takes_off_half_of_itself_and_says_how_sure_that_is(
    simulated: Recording, clock: bool
) -> None:
    recording = asked(made_up(simulated, "q6", 2_000_000, clock=clock), 4_000_000, 40_000_000)
    found = taken(recording, RIG.channel("q6"), recording.session.start_ns)
    off_s = found.time_s - (instants(recording) - recording.session.start_ns) * 1e-9
    assert abs(float(np.mean(off_s))) < 1.96 * found.uncertainty_s
    if clock:
        assert off_s == pytest.approx(0.0, abs=20e-6)
        assert found.uncertainty_s == pytest.approx(4e-3 / np.sqrt(12.0), rel=1e-3)
    else:
        assert found.uncertainty_s > 40e-3 / np.sqrt(12.0)


def test_a_clock_that_does_not_fit_is_not_believed(simulated: Recording) -> None:
    recording = made_up(simulated, "q6", 2_000_000, clock=True)
    wrong = tuple(replace(sample, offset_ns=sample.offset_ns + 10**8) for sample in recording.clock)
    found = taken(replace(recording, clock=wrong), RIG.channel("q6"), recording.session.start_ns)
    off_s = found.time_s - (instants(recording) - recording.session.start_ns) * 1e-9
    # The line through the arrivals: their mean, and little of their jitter of 10 ms.
    assert np.std(off_s) < 1e-3
    assert 2e-3 < np.mean(off_s) < 10e-3


def test_readings_in_motion_are_corrected_for_the_skew_between_devices(
    simulated: Recording,
) -> None:
    """The wrist's converter answers 10 ms late, which its round trips show."""
    late_ns = 10_000_000
    late = {
        name: replace(r, time_ns=r.time_ns + late_ns * (RIG.channel(name).device == "wrist-adc"))
        for name, r in simulated.readings.items()
    }
    skewed = replace(simulated, readings=late)
    corrected = asked(skewed, 2 * late_ns, 2 * late_ns)
    speeds = with_motion(simulated, average(simulated))[0].rate
    assert speeds is not None
    assert np.abs(speeds[:, -1]).max() > 0.05

    def off(recording: Recording) -> float:
        channel = RIG.channel("q7")
        was = taken(simulated, channel, simulated.session.start_ns).time_s
        return float(np.mean(taken(recording, channel, simulated.session.start_ns).time_s - was))

    assert off(skewed) == pytest.approx(10e-3, abs=1e-5)
    assert abs(off(corrected)) < 1e-5
    moving = len(average(simulated).counts)
    sigma = [with_motion(r, average(r))[0].sigma[moving:, -1] for r in (skewed, corrected)]
    assert np.median(sigma[1]) > np.median(sigma[0])
