"""What is said of a device's clock is true as often as it says: seeded simulations, no wires."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from daq.device_clock import BLOCK_S, CONFIDENCE, FEWEST, DeviceClock
from daq.device_clocks import DeviceClocks
from recordings.events import ClockSample, Reading, ReadingFlag, RoundTrip

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
FLOOR_S = 0.8e-3
RUNS = 120


@dataclass(frozen=True)
class World:
    """A device with a clock of its own behind a line with queues."""

    seconds: float = 30.0
    rate_hz: float = 100.0
    step_ns: int = 1_000
    law: str = "exponential"
    bursts: bool = True
    drift: float | None = None

    def play(self, seed: int) -> tuple[list[tuple[int, int]], float, float]:
        """Pairs of device time and arrival [ns]; true offset at device time 0 [s], true drift."""
        rng = np.random.default_rng([seed, 11])
        drift = rng.uniform(-50e-6, 50e-6) if self.drift is None else self.drift
        offset_s = rng.uniform(-100.0, 100.0)
        time_s = np.arange(round(self.seconds * self.rate_hz)) / self.rate_hz + rng.uniform()
        device_s = (time_s - offset_s) / (1.0 + drift)
        device_ns = np.floor(device_s * 1e9 / self.step_ns).astype(np.int64) * self.step_ns
        delays = {
            "exponential": lambda n: rng.exponential(150e-6, n),
            "gamma": lambda n: rng.gamma(2.0, 75e-6, n),
            "half normal": lambda n: np.abs(rng.normal(0.0, 150e-6, n)),
        }
        delay_s = FLOOR_S + delays[self.law](len(time_s))
        for _ in range(rng.poisson(self.seconds / 8.0) if self.bursts else 0):
            begin, lasts = rng.uniform(0.0, self.seconds), rng.uniform(0.05, 1.2)
            busy = (time_s - time_s[0] > begin) & (time_s - time_s[0] < begin + lasts)
            delay_s[busy] += rng.uniform(1e-3, 20e-3)
        arrival_s = np.maximum.accumulate(time_s + delay_s)
        arrival_ns = START_NS + np.rint(arrival_s * 1e9).astype(np.int64)
        pairs = list(zip(device_ns.tolist(), arrival_ns.tolist(), strict=True))
        return pairs, START_NS / SECOND + offset_s, drift


def followed(pairs: list[tuple[int, int]]) -> DeviceClock:
    clock = DeviceClock()
    for device_ns, arrival_ns in pairs:
        clock.add(device_ns, arrival_ns)
    return clock


WORLDS = {
    "as it comes": World(),
    "coarse steps": World(step_ns=100_000),
    "very coarse steps": World(step_ns=1_000_000),
    "hardly any drift, coarse": World(step_ns=100_000, drift=0.3e-6),
    "gamma": World(law="gamma", step_ns=1),
    "half normal": World(law="half normal", step_ns=1),
    "slow": World(rate_hz=10.0, seconds=60.0),
    "short": World(seconds=5.0),
    "long": World(seconds=100.0, rate_hz=50.0),
}


@pytest.mark.parametrize("name", WORLDS)
def test_the_intervals_hold_the_truth(name: str) -> None:
    world = WORLDS[name]
    offsets, drifts, runs = 0, 0, 0
    for seed in range(RUNS):
        pairs, offset_s, drift = world.play(seed)
        found = followed(pairs).estimate()
        if found is None:
            continue
        runs += 1
        device_s = found.device_time_ns / SECOND
        # Whole seconds apart, so that what is left fits a double.
        true_ns = (offset_s - START_NS / SECOND + FLOOR_S + drift * device_s) * 1e9
        error_ns = found.offset_ns - START_NS - true_ns
        offsets += abs(error_ns) <= CONFIDENCE * found.uncertainty_ns
        drifts += abs(found.drift - drift) <= CONFIDENCE * found.drift_uncertainty
    assert runs >= 0.95 * RUNS
    assert offsets / runs >= 0.93
    assert drifts / runs >= 0.93


def test_the_intervals_are_worth_something() -> None:
    found = followed(World(seconds=60.0).play(1)[0]).estimate()
    assert found is not None
    assert found.uncertainty_ns < 20_000
    assert found.drift_uncertainty < 0.1e-6
    coarse = followed(World(seconds=60.0, step_ns=100_000).play(1)[0]).estimate()
    assert coarse is not None
    assert coarse.uncertainty_ns < 100_000


def test_nothing_is_said_before_there_is_something_to_say() -> None:
    pairs, _, _ = World(bursts=False).play(1)
    enough = round((FEWEST - 1) * BLOCK_S * 100)
    assert followed(pairs[:enough]).estimate() is None
    assert followed(pairs[: 2 * enough]).estimate() is not None


@pytest.mark.parametrize("jump_s", [-20.0, 5000.0])
def test_a_device_that_restarts_has_another_clock(jump_s: float) -> None:
    world = World(bursts=False, seconds=10.0)
    pairs, offset_s, drift = world.play(3)
    after = [(d + round(jump_s * SECOND), h + round(world.seconds * SECOND)) for d, h in pairs]
    clock = followed([*pairs, *after])
    assert clock.restarts == 1
    found = clock.estimate()
    assert found is not None
    device_s = found.device_time_ns / SECOND - jump_s
    true_ns = (offset_s - START_NS / SECOND + FLOOR_S + drift * device_s) * 1e9
    true_ns += (world.seconds - jump_s) * SECOND
    assert abs(found.offset_ns - START_NS - true_ns) < 4 * found.uncertainty_ns + 1000


def readings(pairs: list[tuple[int, int]], channel: str, flags: int = 0) -> list[Reading]:
    return [Reading(channel, h, 0, d, None, ReadingFlag(flags)) for d, h in pairs]


def test_a_device_is_told_of_once_a_second_whatever_its_channels() -> None:
    clocks = DeviceClocks({"q1": "e", "q2": "e", "q3": "f"})
    pairs, _, _ = World(bursts=False, seconds=20.0).play(5)
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
