"""A small rig and a small session that every recording test starts from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    Mark,
    Mode,
    ModeCommand,
    ModeReport,
    Reading,
    ReadingFlag,
    RoundTrip,
    SessionState,
    StateChange,
)
from recordings.session import Session
from recordings.writer import Writer

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000

RIG = """\
# A comment, and an umlaut: Prüfstand. Both must survive.
schema = 1
name = "bench"

[mechanism]
family = "serial"

[[mechanism.joint]]
name = "base"
a_m = 0.3

[[mechanism.joint]]
name = "elbow"
a_mm = { nominal = 250, uncertainty = 1, identify = true }

[[mechanism.joint]]
name = "slide"
type = "prismatic"

[[channel]]
name = "q1"
senses = "base"
gain_deg_per_count = 0.01

[[channel]]
name = "q2"
senses = "elbow"
gain_deg_per_count = 0.02
"""


@pytest.fixture
def rig_toml() -> str:
    return RIG


@pytest.fixture
def session() -> Session:
    return Session("2023-11-14-a", START_NS, "Ada", "first\nsecond", "bench-pc", "loopcal 9")


@pytest.fixture
def one_of_each() -> tuple[Event, ...]:
    """Every kind of event, with every optional field once given and once not."""
    t = START_NS
    return (
        Reading("q1", t + 1, -(2**63), 2**63 - 1, 2**32 - 1, ReadingFlag.OVERRANGE),
        Reading("q2", t + 2, 7),
        ModeCommand("base", t + 3, Mode.POSITION, -5, "pose 1"),
        ModeCommand("elbow", t + 4, Mode.FREE, None, ""),
        ModeReport("base", t + 5, Mode.FAULT, 0x1208, 0x8611),
        ModeReport("elbow", t + 6, Mode.UNKNOWN, 0),
        Dwell(t + 7, t + 1, t + 6, 3, 0),
        Dwell(t + 8, t + 2, t + 7, 4, 1, "socket"),
        Mark(t + 8, "a remark — with a dash"),
        Fault(t + 9, "can0", "unplugged", "The adapter is gone."),
        StateChange(t + 10, SessionState.MOVING, SessionState.SAFE, "joint1 is too fast"),
        ClockSample("encoder1", t + 10, 123, t, 1000, -20_000, 15),
        ClockSample("rig/encoder2", t + 11, 0, -1, 0),
        RoundTrip("encoder1", t + 12, 800_000, 3_000_000),
    )


@pytest.fixture
def write_session(rig_toml: str, session: Session) -> Callable[..., Path]:
    """Writes a session of ``seconds`` at 100 Hz, flushed once a second; returns the file."""

    def write(path: Path, seconds: int = 3) -> Path:
        with Writer(path, rig_toml, session) as writer:
            for i in range(100 * seconds):
                t = START_NS + i * STEP_NS
                writer.write(Reading("q1", t, 1000 + i, 500 + i, i))
                writer.write(Reading("q2", t + 1, -i))
                if i % 100 == 99:
                    writer.write(Dwell(t + 2, t - STEP_NS, t, i // 100, 0))
                    writer.flush(t + 3)
        return path

    return write
