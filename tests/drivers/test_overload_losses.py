"""A host that cannot keep up: what an adapter throws away meanwhile is in the balance, to a reading.

While the host is held up, the port's buffers fill, and behind them frames are lost. What is then
read at once was sent over a long time: frames with counters far apart have one time of arrival.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.stream_tally import StreamTally

PERIOD_NS = 333_333
HELD = 900  # readings that the buffers hold


def arrivals(rng: np.random.Generator, seconds: float) -> list[tuple[int, int]]:
    """Time and counter of what an overloaded host reads of a device at 3 kHz."""
    out: list[tuple[int, int]] = []
    waiting: list[int] = []
    sent = 0
    time_ns = 0
    while time_ns < seconds * 1e9:
        pause_ns = int(rng.choice([2_000_000, 20_000_000, 400_000_000], p=[0.9, 0.07, 0.03]))
        time_ns += pause_ns
        upto = time_ns // PERIOD_NS
        waiting += [n for n in range(sent, upto) if len(waiting) + n - sent < HELD]
        sent = upto
        # It does not take all that waits, so that the buffers stay full for a while.
        for _ in range(int(rng.integers(3, 120))):
            if waiting:
                out.append((time_ns, waiting.pop(0)))
                # Room is made while the host reads, and filled with what comes right then.
                if len(waiting) == HELD - 1 and rng.random() < 0.3 and sent > waiting[-1]:
                    waiting.append(sent)
                    sent += 1
    return out


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("period_ns", [None, PERIOD_NS])
def test_every_step_of_the_counter_is_a_loss(seed: int, period_ns: int | None) -> None:
    read = arrivals(np.random.default_rng(seed), 20.0)
    tally = StreamTally(period_ns)
    tally.begin(0)
    last: int | None = None
    for time_ns, counter in read:
        tally.receive(time_ns, None if last is None else counter - last)
        last = counter
    assert last is not None
    tally.end(read[-1][0])
    missing = last - read[0][1] + 1 - len(read)
    assert missing > 1000
    found = tally.losses(read[-1][0])
    assert found.dropped_by_device + found.lost_in_gaps == missing
    assert found.expected == len(read) + missing
