"""How well clocks of devices are estimated, side by side: python benchmarks/clock_offset.py [--runs 200]

Simulated sessions of a device with a clock of its own behind a line with queues
(`sim_devices.queued_clock`), followed by

    used            the estimator of a capture session (`daq.device_clock`)
    least squares   a straight line through all host - device times, less nothing
    lower line      the line below all points with the least area (linear program: Moon, Skelly and
                    Towsley, "Estimation and removal of clock skew from network delay
                    measurements", INFOCOM 1999), by the lower convex hull
    last reading    host - device time of the last reading; no drift

Prints root mean square errors of the offset at the end of the session and of the drift, as
multiples of those of the first method, and for that one how many of its 95 % intervals hold
the truth. "Offset" contains the shortest delay, for all of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from daq.device_clock import CONFIDENCE, DeviceClock
from sim_devices.crystal import Crystal
from sim_devices.queued_clock import EPOCH_NS, Arrivals, QueuedClock

WORLDS = {
    "30 s at 100 Hz, 1 us": QueuedClock(),
    "the same, 100 us steps": QueuedClock(step_ns=100_000),
    "the same, 1 ms steps": QueuedClock(step_ns=1_000_000),
    "100 us, 0.3 ppm": QueuedClock(step_ns=100_000, crystal=Crystal(0.3e-6)),
    "100 us, 0.3 ppm, like clockwork": QueuedClock(
        step_ns=100_000, crystal=Crystal(0.3e-6), punctual_s=0.0
    ),
    "gamma delays": QueuedClock(law="gamma"),
    "half normal delays": QueuedClock(law="half normal"),
    "5 s": QueuedClock(seconds=5.0),
    "60 s at 10 Hz": QueuedClock(seconds=60.0, rate_hz=10.0),
    "60 s at 1 kHz": QueuedClock(seconds=60.0, rate_hz=1000.0),
}

Line = tuple[float, float]
"""Offset beyond the epoch [ns] at the end of a session, and drift."""


def points(seen: Arrivals) -> tuple[np.ndarray, np.ndarray]:
    """Device time [s] before the end, and host - device time beyond the first one [ns]."""
    time_s = (seen.device_ns - seen.device_ns[-1]) * 1e-9
    away = seen.host_ns - EPOCH_NS - seen.device_ns
    return time_s, (away - away[0]).astype(np.float64)


def first_away(seen: Arrivals) -> float:
    """Host - device time of the first reading, beyond the epoch [ns]."""
    return float(seen.host_ns[0] - EPOCH_NS - seen.device_ns[0])


def least_squares(seen: Arrivals) -> Line:
    time_s, above = points(seen)
    slope, level = np.polyfit(time_s, above, 1)
    return first_away(seen) + level, slope * 1e-9


def lower_line(seen: Arrivals) -> Line:
    time_s, above = points(seen)
    hull: list[int] = []
    for k in range(len(time_s)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            turn = (time_s[b] - time_s[a]) * (above[k] - above[a])
            if turn > (time_s[k] - time_s[a]) * (above[b] - above[a]):
                break
            hull.pop()
        hull.append(k)
    # The edge above the mean time is the line with the least area.
    edge = int(np.searchsorted(time_s[hull], time_s.mean()))
    a, b = hull[max(edge - 1, 0)], hull[max(edge, 1)]
    slope = (above[b] - above[a]) / (time_s[b] - time_s[a])
    return first_away(seen) + above[a] - slope * time_s[a], slope * 1e-9


def last_reading(seen: Arrivals) -> Line:
    return first_away(seen) + points(seen)[1][-1], 0.0


OTHERS: dict[str, Callable[[Arrivals], Line]] = {
    "least squares": least_squares,
    "lower line": lower_line,
    "last reading": last_reading,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="sessions of each kind")
    runs = parser.parse_args().runs
    print("| Sessions | Offset off by | Drift off by | Offset held | Drift held |", end="")
    print("".join(f" {name}: offset, drift |" for name in OTHERS))
    print("|---|---|---|---|---|" + "---|" * len(OTHERS))
    for name, world in WORLDS.items():
        errors: dict[str, list[Line]] = {"used": [], **{other: [] for other in OTHERS}}
        held: list[tuple[bool, bool]] = []
        for seed in range(runs):
            seen = world.play(seed)
            clock = DeviceClock()
            for device_ns, host_ns in zip(
                seen.device_ns.tolist(), seen.host_ns.tolist(), strict=True
            ):
                clock.add(device_ns, host_ns)
            found = clock.estimate()
            if found is None:
                continue
            true_ns = seen.true_offset_ns(int(seen.device_ns[-1]))
            off = (found.offset_ns - EPOCH_NS - true_ns, found.drift - seen.drift)
            errors["used"].append(off)
            limits = (CONFIDENCE * found.uncertainty_ns, CONFIDENCE * found.drift_uncertainty)
            held.append((abs(off[0]) <= limits[0], abs(off[1]) <= limits[1]))
            for other, method in OTHERS.items():
                offset_ns, drift = method(seen)
                errors[other].append((offset_ns - true_ns, drift - seen.drift))
        rms = {each: np.sqrt(np.mean(np.square(off), axis=0)) for each, off in errors.items()}
        used = rms.pop("used")
        print(
            f"| {name} | {used[0] / 1e3:.1f} us | {used[1] * 1e6:.3f} ppm | "
            + " | ".join(f"{100 * share:.0f} %" for share in np.mean(held, axis=0))
            + " | "
            + " | ".join(f"{r[0] / used[0]:.1f}, {r[1] / used[1]:.1f}" for r in rms.values())
            + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()
