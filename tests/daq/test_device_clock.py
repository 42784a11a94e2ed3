"""What is said of a device's clock is true as often as it says: seeded simulations, no wires."""

from __future__ import annotations

from itertools import pairwise

import pytest

from daq.device_clock import BLOCK_S, CONFIDENCE, FEWEST, DeviceClock
from daq.device_clocks import DeviceClocks
from recordings.events import ClockSample, Reading, ReadingFlag, RoundTrip
from sim_devices.crystal import Crystal
from sim_devices.queued_clock import EPOCH_NS, Arrivals, QueuedClock

SECOND = 1_000_000_000
RUNS = 80


def pairs_of(seen: Arrivals) -> list[tuple[int, int]]:
    return list(zip(seen.device_ns.tolist(), seen.host_ns.tolist(), strict=True))


def followed(pairs: list[tuple[int, int]]) -> DeviceClock:
    clock = DeviceClock()
    for device_ns, arrival_ns in pairs:
        clock.add(device_ns, arrival_ns)
    return clock


WORLDS = {
    "as it comes": QueuedClock(),
    "coarse steps": QueuedClock(step_ns=100_000),
    "very coarse steps": QueuedClock(step_ns=1_000_000),
    "hardly any drift, coarse": QueuedClock(step_ns=100_000, crystal=Crystal(0.3e-6)),
    "like clockwork": QueuedClock(step_ns=100_000, punctual_s=0.0),
    "gamma": QueuedClock(law="gamma", step_ns=1),
    "half normal": QueuedClock(law="half normal", step_ns=1),
    "slow": QueuedClock(rate_hz=10.0, seconds=60.0),
    "short": QueuedClock(seconds=5.0),
    "long": QueuedClock(seconds=100.0, rate_hz=50.0),
}


@pytest.mark.parametrize("name", WORLDS)
def test_the_intervals_hold_the_truth(name: str) -> None:
    world = WORLDS[name]
    offsets, drifts, runs = 0, 0, 0
    for seed in range(RUNS):
        seen = world.play(seed)
        found = followed(pairs_of(seen)).estimate()
        if found is None:
            continue
        runs += 1
        error_ns = found.offset_ns - EPOCH_NS - seen.true_offset_ns(found.device_time_ns)
        offsets += abs(error_ns) <= CONFIDENCE * found.uncertainty_ns
        drifts += abs(found.drift - seen.drift) <= CONFIDENCE * found.drift_uncertainty
    assert runs >= 0.95 * RUNS
    assert offsets / runs >= 0.93
    assert drifts / runs >= 0.93


def test_the_intervals_are_worth_something() -> None:
    found = followed(pairs_of(QueuedClock(seconds=60.0).play(1))).estimate()
    assert found is not None
    assert found.uncertainty_ns < 20_000
    assert found.drift_uncertainty < 0.1e-6
    coarse = followed(pairs_of(QueuedClock(seconds=60.0, step_ns=100_000).play(1))).estimate()
    assert coarse is not None
    assert coarse.uncertainty_ns < 100_000


def test_busy_spells_and_a_garbled_time_do_not_matter() -> None:
    seen = QueuedClock(bursts=False).play(8)
    pairs = pairs_of(seen)
    busy = [(d, h + 40_000_000 * (500 < k < 900)) for k, (d, h) in enumerate(pairs)]
    busy[1700] = (busy[1700][0] + 9_000_000, busy[1700][1])  # less than one period: no step back
    found = followed(busy).estimate()
    assert found is not None
    error_ns = found.offset_ns - EPOCH_NS - seen.true_offset_ns(found.device_time_ns)
    assert abs(error_ns) < CONFIDENCE * found.uncertainty_ns < 20_000
    assert abs(found.drift - seen.drift) < CONFIDENCE * found.drift_uncertainty < 1e-6


def test_nothing_is_said_before_there_is_something_to_say() -> None:
    pairs = pairs_of(QueuedClock(bursts=False).play(1))
    enough = round((FEWEST - 1) * BLOCK_S * 100)
    assert followed(pairs[:enough]).estimate() is None
    assert followed(pairs[: 2 * enough]).estimate() is not None


@pytest.mark.parametrize("jump_s", [-20.0, 5000.0])
def test_a_device_that_restarts_has_another_clock(jump_s: float) -> None:
    world = QueuedClock(bursts=False, seconds=10.0)
    seen = world.play(3)
    pairs = pairs_of(seen)
    after = [(d + round(jump_s * SECOND), h + round(world.seconds * SECOND)) for d, h in pairs]
    clock = followed([*pairs, *after])
    assert clock.restarts == 1
    found = clock.estimate()
    assert found is not None
    true_ns = seen.true_offset_ns(found.device_time_ns - round(jump_s * SECOND))
    true_ns += (world.seconds - jump_s) * SECOND
    assert abs(found.offset_ns - EPOCH_NS - true_ns) < 4 * found.uncertainty_ns + 1000


def readings(pairs: list[tuple[int, int]], channel: str, flags: int = 0) -> list[Reading]:
    return [Reading(channel, h, 0, d, None, ReadingFlag(flags)) for d, h in pairs]


def test_a_device_is_told_of_once_a_second_whatever_its_channels() -> None:
    clocks = DeviceClocks({"q1": "e", "q2": "e", "q3": "f"})
    pairs = pairs_of(QueuedClock(bursts=False, seconds=20.0).play(5))
    said: list[ClockSample] = []
    for one, two, three in zip(
        readings(pairs, "q1"), readings(pairs, "q2"), readings(pairs, "q3", 4), strict=True
    ):
        said += clocks.follow([one, two, three])
    assert {sample.source for sample in said} == {"e"}
    assert 14 <= len(said) <= 20
    times = [sample.time_ns for sample in said]
    assert min(b - a for a, b in pairwise(times)) >= SECOND
    assert said[-1].drift_ppb is not None
    assert clocks.known == ((said[-1],), ())


def test_round_trips_are_kept_by_their_shortest_and_longest() -> None:
    clocks = DeviceClocks({"q1": "e"})
    assert clocks.follow([RoundTrip("e", 1, 5, 9), RoundTrip("e", 2, 4, 7)]) == []
    assert clocks.known == ((), (RoundTrip("e", 2, 4, 9),))
