"""What is found wrong with a recording, in words; and that a sound one is left in peace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from recordings.errors import DiskFailed
from recordings.events import (
    ClockSample,
    Dwell,
    Event,
    Fault,
    LedgerEntry,
    Mark,
    Reading,
    ReadingFlag,
)
from recordings.health import Finding, Severity, findings
from recordings.reader import read_recording
from recordings.session import Session
from recordings.survey import survey
from recordings.writer import Writer

SAMPLES = Path(__file__).parents[2] / "recordings" / "samples"
START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
HOUR = 3600 * SECOND

Diagnose = Callable[..., dict[str, Finding]]


def both(count: int = 500, start_ns: int = START_NS, step_ns: int = 10_000_000) -> list[Event]:
    """Readings of both channels that nothing is wrong with, and a dwell."""
    out: list[Event] = []
    for i in range(count):
        out.append(Reading("q1", start_ns + i * step_ns, i % 97, sequence=i))
        out.append(Reading("q2", start_ns + i * step_ns, -(i % 89)))
    return [*out, Dwell(start_ns + count * step_ns, start_ns, start_ns + SECOND, 0, 0)]


@pytest.fixture
def diagnose(tmp_path: Path, rig_toml: str, session: Session) -> Diagnose:
    """Findings, by kind, on a closed recording of these events."""

    def run(events: Sequence[Event], session: Session = session) -> dict[str, Finding]:
        path = tmp_path / "a.mcap"
        path.unlink(missing_ok=True)
        with Writer(path, rig_toml, session) as writer:
            for i, event in enumerate(events):
                writer.write(event)
                if i % 50 == 49:
                    writer.flush()
        return {finding.kind: finding for finding in findings(survey(path))}

    return run


def test_a_sound_recording_has_no_findings(diagnose: Diagnose) -> None:
    assert diagnose(both()) == {}


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_the_samples_are_well(name: str) -> None:
    found = findings(survey(SAMPLES / f"{name}.mcap"))
    assert {finding.kind for finding in found} <= {"no-dwells"}


def test_a_clock_step_of_hours_is_told_and_costs_nothing(
    diagnose: Diagnose, tmp_path: Path
) -> None:
    """As a program records whose clock is the system's own; this one's cannot step."""
    later = both(start_ns=START_NS + 5 * SECOND - 3 * HOUR)
    found = diagnose([*both(), *later])
    assert found["time-back"].severity is Severity.BAD
    assert (
        "goes back 1 time, by up to 10799.990 s, in q1, q2, /session/dwell"
        in found["time-back"].text
    )
    assert len(read_recording(tmp_path / "a.mcap").readings["q1"]) == 1000
    found = diagnose([*both(), *both(start_ns=START_NS + 5 * SECOND + 3 * HOUR)])
    assert "all channels are silent for 10800.0 s, at 5.0 s" in found["silence"].text
    assert "its clock was set" in found["silence"].remedy
    found = diagnose(both(start_ns=START_NS - 2 * HOUR))
    assert "-2.0 h from the stated start" in found["clock"].text


def test_losses_that_the_ledger_knows_are_told_with_a_remedy(diagnose: Diagnose) -> None:
    entry = LedgerEntry("q2", START_NS + 5 * SECOND, 506, 500, 1, 2, 3, 1)
    (finding,) = diagnose([*both(), entry]).values()
    assert finding.severity is Severity.CAUTION
    assert finding.text == "q2: 3 of 506 readings were lost in 1 gap"
    assert finding.remedy


def test_a_ledger_that_does_not_add_up_is_bad(diagnose: Diagnose) -> None:
    found = diagnose([*both(), LedgerEntry("q2", START_NS + 5 * SECOND, 510, 500, 0, 0, 0, 0)])
    assert found["unaccounted"].severity is Severity.BAD
    assert "q2: 10 of 510 expected readings are unaccounted for" in found["unaccounted"].text
    found = diagnose([*both(), LedgerEntry("q2", START_NS + 5 * SECOND, 490, 500, 0, 0, 0, 0)])
    assert "10 of 490 expected readings are accounted for twice" in found["unaccounted"].text


@pytest.mark.parametrize("received", [499, 501])
def test_a_ledger_that_contradicts_the_file_is_bad(diagnose: Diagnose, received: int) -> None:
    found = diagnose(
        [*both(), LedgerEntry("q2", START_NS + 5 * SECOND, received, received, 0, 0, 0, 0)]
    )
    bad = {kind for kind, finding in found.items() if finding.severity is Severity.BAD}
    # One too many looks the same as a reading that is missing at the end of the file.
    assert bad == {"ledger-mismatch" if received == 499 else "missing"}


def test_samples_that_the_device_counted_and_nobody_has_are_bad(diagnose: Diagnose) -> None:
    gone = [e for e in both() if not (isinstance(e, Reading) and e.channel == "q1" and e.raw == 50)]
    found = diagnose(gone)
    assert "q1: the device's counter leaves out 5 samples, of which the ledger knows 0" in (
        found["device-counter"].text
    )
    known = LedgerEntry("q1", START_NS + 5 * SECOND, 500, 495, 5, 0, 0, 0)
    assert "device-counter" not in diagnose([*gone, known])


def test_a_stuck_channel_is_told(diagnose: Diagnose) -> None:
    stuck = [
        Reading("q1", e.time_ns, 7) if isinstance(e, Reading) and e.channel == "q1" else e
        for e in both()
    ]
    assert diagnose(stuck)["stuck"].text == "q1: all 500 readings are 7"


def test_a_channel_that_sticks_on_the_way_is_told(diagnose: Diagnose) -> None:
    step = 100_000_000
    late = [
        Reading("q1", e.time_ns, 7)
        if isinstance(e, Reading) and e.channel == "q1" and e.time_ns > START_NS + 20 * SECOND
        else e
        for e in both(step_ns=step)
    ]
    text = diagnose(late)["stuck"].text
    assert text == "q1: 299 readings in a row are equal, 29.8 s from 20.1 s on"


def test_a_silent_channel_is_told(diagnose: Diagnose) -> None:
    away = [
        e
        for e in both()
        if not (
            isinstance(e, Reading) and e.channel == "q2" and 1 < (e.time_ns - START_NS) / 1e9 < 3
        )
    ]
    assert diagnose(away)["silence"].text == "q2: no reading for 2.0 s, at 1.0 s"


def test_a_channel_without_readings_is_told(diagnose: Diagnose) -> None:
    one = [e for e in both() if not (isinstance(e, Reading) and e.channel == "q2")]
    assert diagnose(one)["no-readings"].severity is Severity.CAUTION
    assert diagnose([])["no-readings"].severity is Severity.BAD


def test_flags_faults_clocks_and_failures_are_told(diagnose: Diagnose) -> None:
    end = START_NS + 6 * SECOND
    found = diagnose(
        [
            *both(),
            Reading("q2", end, 5, flags=ReadingFlag.OVERRANGE | ReadingFlag.STALE),
            Fault(end, "can0", "unplugged", "The adapter is gone."),
            Fault(end, "can0", "unplugged", "Again."),
            ClockSample("encoder1", end, 1, 1000, 10),
            ClockSample("encoder1", end, 2, 1000 + SECOND, 10),
            Mark(end, "session failed: the arm ran away"),
        ]
    )
    assert "q2: 1 reading " in found["flagged"].text
    assert found["faults"].text == "2 faults during the session: can0 unplugged ×2"
    assert "the clock of encoder1 jumped 1 time" in found["clock"].text
    assert found["failed"].text == "the session failed: the arm ran away"


def test_no_dwells_is_a_note(diagnose: Diagnose) -> None:
    assert diagnose(both()[:-1])["no-dwells"].severity is Severity.NOTE


def test_a_killed_session_is_told_with_what_to_do(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    writer = Writer(tmp_path / "a.mcap", rig_toml, session)
    for event in both():
        writer.write(event)
    writer.flush()
    found = {finding.kind: finding for finding in findings(survey(tmp_path / "a.mcap"))}
    writer.close()
    assert set(found) == {"never-closed"}
    assert "loopcal recover" in found["never-closed"].remedy


def test_damage_is_told_once_for_alike_channels(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    path = tmp_path / "a.mcap"
    with Writer(path, rig_toml, session) as writer:
        for i, event in enumerate(both()):
            writer.write(event)
            if i % 200 == 199:
                writer.flush()
    data = bytearray(path.read_bytes())
    second = data.index(b"\x04\0\0\0zstd", data.index(b"\x04\0\0\0zstd") + 8)
    data[second + 40] ^= 1
    path.write_bytes(data)
    found = {finding.kind: finding for finding in findings(survey(path))}
    assert set(found) == {"damaged", "missing"}
    assert found["missing"].text.endswith("q1, q2: 100 readings each, 1.0 s to 2.0 s")
    assert found["damaged"].severity is found["missing"].severity is Severity.BAD


def test_a_full_disk_is_told(
    tmp_path: Path, rig_toml: str, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recordings.storage import RecordingFile

    writer = Writer(tmp_path / "a.mcap", rig_toml, session)
    for event in both():
        writer.write(event)
    writer.flush()
    for event in both(start_ns=START_NS + 5 * SECOND)[:40]:
        writer.write(event)
    with monkeypatch.context() as patch:
        patch.setattr(RecordingFile, "room", lambda self: 1000)
        with pytest.raises(DiskFailed):
            writer.flush()
    found = {finding.kind: finding for finding in findings(survey(tmp_path / "a.mcap"))}
    assert "recording disk" in found["faults"].text
    assert "20 of 520 readings were lost by this computer" in found["losses"].text
    assert "unaccounted" not in found


def test_what_is_bad_comes_first(diagnose: Diagnose) -> None:
    stuck = [Reading("q1", START_NS + i, 7) for i in range(20)]
    found = diagnose([*stuck, LedgerEntry("q1", START_NS, 30, 20, 0, 0, 0, 0)])
    order = list(Severity)
    ranks = [order.index(finding.severity) for finding in found.values()]
    assert ranks == sorted(ranks)
    assert len(set(ranks)) > 1
