"""Sessions in parts, and on disks that fill up: no reading goes unaccounted for."""

from __future__ import annotations

import pytest

from daq import CannotRecord, CaptureOptions, Ending, capture
from recordings.reader import read_recording
from recordings.storage import RecordingFile, Storage, Sync


def run(bench, path, storage):
    options = CaptureOptions(storage=storage)
    return capture(
        bench.rig, bench.toml, path, links=bench.links, clock=bench.clock, options=options
    )


def test_a_session_in_parts_is_read_as_one(arm, tmp_path):
    summary = run(arm, tmp_path / "arm.mcap", Storage(sync=Sync.NEVER, rotate_s=2.0))
    assert summary.ending is Ending.COMPLETE, summary.why
    assert summary.parts == len(list(tmp_path.glob("*.mcap"))) > 2
    recording = read_recording(tmp_path / "arm.mcap")
    assert tuple(recording.dwells) == summary.dwells
    for channel, entry in summary.ledger.items():
        assert entry.unaccounted == 0
        assert entry == recording.ledger[channel]
        assert len(recording.readings[channel]) == entry.received


def test_a_nearly_full_disk_ends_the_session_in_order(arm, tmp_path, monkeypatch):
    """The drives are made safe and the end is recorded: that is what the reserve is for."""
    room = iter([10**9] * 3)
    monkeypatch.setattr(RecordingFile, "room", lambda self: next(room, 40_000_000))
    storage = Storage(sync=Sync.NEVER, reserve_bytes=50_000_000)
    summary = run(arm, tmp_path / "arm.mcap", storage)
    assert summary.ending is Ending.FAILED
    assert "the disk is nearly full" in summary.why
    assert "40.0 MB" in summary.why
    recording = read_recording(tmp_path / "arm.mcap")
    assert recording.marks[-1].text.startswith("session failed: the recording cannot go on")
    for channel, entry in summary.ledger.items():
        assert entry.unaccounted == 0
        assert entry.dropped_by_host == 0
        assert len(recording.readings[channel]) == entry.received > 0


def test_a_disk_that_is_full_at_once_ends_the_session_and_counts_the_rest(
    arm, tmp_path, monkeypatch
):
    """Another program took what was left, the reserve included.

    How much is lost depends on what the thread of the file had taken by then; all of it is counted.
    """
    room = iter([10**9])  # for the first chunk
    monkeypatch.setattr(RecordingFile, "room", lambda self: next(room, 1000))
    summary = run(arm, tmp_path / "arm.mcap", Storage(sync=Sync.NEVER))
    assert summary.ending is Ending.FAILED
    assert "the disk is full; make room" in summary.why
    recording = read_recording(tmp_path / "arm.mcap")
    for channel, entry in summary.ledger.items():
        assert entry.unaccounted == 0
        assert len(recording.readings[channel]) == entry.received
        assert recording.ledger[channel].unaccounted == 0
    assert {fault.kind for fault in recording.faults} >= {"disk"}


def test_a_disk_without_its_reserve_is_refused_before_anything_moves(arm, tmp_path):
    with pytest.raises(CannotRecord, match=r"MB left, less than the reserve of .*make room first"):
        run(arm, tmp_path / "arm.mcap", Storage(reserve_bytes=2**62))
    assert list(tmp_path.iterdir()) == []
    assert arm.log == []
