"""What `loopcal capture` prints at the end: states with causes, timing of devices, skew of ports."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq import CaptureSummary, Ending
from loopcal.capturing import show_summary
from loopcal.timing_view import described
from recordings.events import ClockSample, SessionState, StateChange
from recordings.timing import DeviceTiming

IDLE, ARMED, MOVING, RECORDING, SAFE = SessionState


def test_states_and_timing_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    states = (
        StateChange(1, IDLE, ARMED, "armed for 600 s"),
        StateChange(2, ARMED, MOVING, "to pose 0"),
        StateChange(3, MOVING, ARMED, "at pose 0"),
        StateChange(4, ARMED, MOVING, "to pose 1"),
        StateChange(5, MOVING, SAFE, "joint1 is too fast"),
        StateChange(6, SAFE, IDLE, "all are off"),
    )
    clock = ClockSample("encoder1", 6, 5, 1, 12_000, -20_300, 400)
    timing = (
        DeviceTiming("encoder1", "can", ("q1",), clock, 700_000, 3_000_000),
        DeviceTiming("adc", "serial", ("q6",), None, 1_200_000, 9_000_000),
    )
    summary = CaptureSummary(
        path=Path("a.mcap"),
        ending=Ending.FAILED,
        why="joint1 is too fast",
        duration_s=3.0,
        stops=4,
        dwells=(),
        ledger={},
        faults=(),
        states=states,
        timing=timing,
    )
    show_summary(summary)
    shown = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in shown.splitlines()]
    assert "armed moving 2 to pose 1" in lines
    assert "moving safe 1 joint1 is too fast" in lines
    assert "encoder1 0.70 to 3.00 ms 12 µs -20.30 ± 0.40 ppm" in lines
    assert "adc 1.20 to 9.00 ms no clock" in lines
    assert any("between -9.00 ms and +0.72 ms before those of serial" in line for line in lines)


def test_timing_as_json_has_the_keys_of_the_document() -> None:
    clock = ClockSample("encoder1", 6, 5, 1, 12_000, -20_300, 400)
    told = described(
        (
            DeviceTiming("encoder1", "can", ("q1",), clock, 700_000, 3_000_000),
            DeviceTiming("stream", "serial", ("q6",), None, None, None),
        )
    )
    assert told == {
        "devices": [
            {
                "device": "encoder1",
                "port": "can",
                "channels": ["q1"],
                "shortest_round_trip_ns": 700_000,
                "longest_round_trip_ns": 3_000_000,
                "clock": {
                    "uncertainty_ns": 12_000,
                    "drift_ppb": -20_300,
                    "drift_uncertainty_ppb": 400,
                },
            },
            {
                "device": "stream",
                "port": "serial",
                "channels": ["q6"],
                "shortest_round_trip_ns": None,
                "longest_round_trip_ns": None,
                "clock": None,
            },
        ],
        "skew": [{"first": "can", "second": "serial", "lowest_ns": None, "highest_ns": 724_000}],
    }
