"""What is known of the times of devices, for people and as JSON: round trips, clocks, skew of ports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from loopcal.console import out
from recordings.timing import DeviceTiming, port_skews


def described(timed: Sequence[DeviceTiming]) -> dict[str, Any]:
    """All of it, as JSON has it; times in nanoseconds, drift in parts per billion."""
    return {
        "devices": [
            {
                "device": each.device,
                "port": each.port,
                "channels": list(each.channels),
                "shortest_round_trip_ns": each.shortest_ns,
                "longest_round_trip_ns": each.longest_ns,
                "clock": None
                if each.clock is None
                else {
                    "uncertainty_ns": each.clock.uncertainty_ns,
                    "drift_ppb": each.clock.drift_ppb,
                    "drift_uncertainty_ppb": each.clock.drift_uncertainty_ppb,
                },
            }
            for each in timed
        ],
        "skew": [
            {
                "first": between.first,
                "second": between.second,
                "lowest_ns": between.lowest_ns,
                "highest_ns": between.highest_ns,
            }
            for between in port_skews(timed)
        ],
    }


def show_timing(timed: Sequence[DeviceTiming]) -> None:
    """Print a table of the devices and a line for every two ports; nothing where nothing is known."""
    if all(each.clock is None and each.longest_ns is None for each in timed):
        return
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in ("device", "answers in", "clock known to", "drift"):
        table.add_column(column, justify="left" if column == "device" else "right", no_wrap=True)
    for each in timed:
        table.add_row(each.device, _trip(each), *_clock(each))
    out.print()
    out.print(table)
    for between in port_skews(timed):
        out.print(
            f"skew: at the same time, readings of {between.first} were taken between "
            f"{_bound(between.lowest_ns)} and {_bound(between.highest_ns)} before those of "
            f"{between.second}",
            markup=False,
            soft_wrap=True,
        )


def _trip(timed: DeviceTiming) -> str:
    if timed.shortest_ns is None or timed.longest_ns is None:
        return "not asked"
    return f"{1e-6 * timed.shortest_ns:.2f} to {1e-6 * timed.longest_ns:.2f} ms"


def _clock(timed: DeviceTiming) -> tuple[str, str]:
    clock = timed.clock
    if clock is None:
        return "no clock", ""
    known = f"{1e-3 * clock.uncertainty_ns:.0f} µs"
    if clock.drift_ppb is None or clock.drift_uncertainty_ppb is None:
        return known, ""
    return known, f"{1e-3 * clock.drift_ppb:+.2f} ± {1e-3 * clock.drift_uncertainty_ppb:.2f} ppm"


def _bound(time_ns: int | None) -> str:
    return "an unknown time" if time_ns is None else f"{1e-6 * time_ns:+.2f} ms"
