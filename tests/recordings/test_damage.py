"""Whatever happens to a file, what is in its whole chunks is read, and the rest is told."""

from __future__ import annotations

import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from recordings.errors import DamagedRecording, NotARecording, RecordingsError
from recordings.events import Reading
from recordings.reader import Recording, read_recording
from recordings.session import Session
from recordings.writer import Writer

MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Sample:
    """A whole file with what is in it: ``chunks`` are (first byte, end, marker counts of q1)."""

    data: bytes
    whole: Recording
    chunks: tuple[tuple[int, int, frozenset[int]], ...]
    index_end: tuple[int, ...]
    rig_end: int
    copy_end: int
    data_end: int

    def counts(self, kept: Callable[[int, int], bool]) -> set[int]:
        """Counts of q1 in the chunks that ``kept(start, end)`` chooses."""
        return set().union(*(counts for start, end, counts in self.chunks if kept(start, end)))


@pytest.fixture
def sample(tmp_path: Path, write_session: Callable[..., Path]) -> Sample:
    """Three seconds, flushed once a second: each chunk has 100 readings of each channel."""
    path = write_session(tmp_path / "whole.mcap")
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    indexes = summary.chunk_indexes
    whole = read_recording(path)
    raw = whole.readings["q1"].raw
    spans = [
        (
            index.chunk_start_offset,
            index.chunk_start_offset + index.chunk_length,
            frozenset(raw[100 * i : 100 * i + 100].tolist()),
        )
        for i, index in enumerate(indexes)
    ]
    attachment, copy = summary.attachment_indexes
    return Sample(
        data=path.read_bytes(),
        whole=whole,
        chunks=tuple(spans),
        index_end=tuple(
            end + index.message_index_length
            for (_, end, _), index in zip(spans, indexes, strict=True)
        ),
        rig_end=attachment.offset + attachment.length,
        copy_end=copy.offset + copy.length,
        data_end=spans[-1][1] + indexes[-1].message_index_length + 13,
    )


def counts_of(recording: Recording) -> set[int]:
    return set(recording.readings["q1"].raw.tolist())


def damaged(path: Path, data: bytes) -> Recording:
    """Read ``data``, after checking that it is refused when damage is not allowed."""
    path.write_bytes(data)
    with pytest.raises(DamagedRecording, match=r"is damaged: .*What can still be read: "):
        read_recording(path)
    recording = read_recording(path, damaged_ok=True)
    assert recording.damage
    return recording


def assert_costs_at_most_its_chunk(sample: Sample, recording: Recording, place: int) -> None:
    """A change at byte ``place`` took the chunk there as a whole, or nothing.

    Nothing where the byte says nothing of the messages: a chunk's start and end times, and
    bits that a zstd frame leaves unused, which its CRC proves.
    """
    others = sample.counts(lambda start, end: not start <= place < end)
    hit = sample.counts(lambda start, end: start <= place < end)
    assert counts_of(recording) in (others, others | hit), place
    if any(9 <= place - start < 25 for start, _, _ in sample.chunks):
        assert counts_of(recording) == others | hit, place


def test_the_sample_is_what_the_tests_think(sample: Sample) -> None:
    assert sample.whole.damage == ()
    assert len(sample.chunks) == 4
    assert [len(counts) for _, _, counts in sample.chunks] == [100, 100, 100, 0]
    assert sample.data[sample.data_end - 13] == 15


def test_a_file_cut_anywhere_gives_its_whole_chunks(sample: Sample, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    edges = {sample.rig_end, sample.data_end, len(sample.data) - 8, len(sample.data) - 37}
    edges |= {edge for start, end, _ in sample.chunks for edge in (start, end)}
    edges |= set(sample.index_end)
    cuts = {cut + step for cut in edges for step in (-1, 0, 1, 8, 9, 10)}
    cuts |= set(rng.integers(0, len(sample.data), 150).tolist())
    path = tmp_path / "cut.mcap"
    for cut in sorted(cut for cut in cuts if cut < len(sample.data)):
        data = sample.data[:cut]
        if cut < sample.rig_end:
            path.write_bytes(data)
            expected = NotARecording if cut < len(MAGIC) else DamagedRecording
            for damaged_ok in (False, True):
                with pytest.raises(expected):
                    read_recording(path, damaged_ok=damaged_ok)
        else:
            recording = damaged(path, data)
            assert counts_of(recording) == sample.counts(lambda _, end, cut=cut: end <= cut), cut


def test_one_flipped_bit_costs_at_most_its_chunk(sample: Sample, tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    every_field = [start + i for start, _, _ in sample.chunks for i in range(60)]
    every_field += [end + i for _, end, _ in sample.chunks for i in range(20)]
    every_field += list(range(sample.data_end - 13, sample.data_end + 9))
    every_field += list(range(len(sample.data) - 37, len(sample.data)))
    places = every_field + rng.integers(0, len(sample.data), 100).tolist()
    places += [*range(len(MAGIC)), *rng.integers(0, sample.rig_end, 40).tolist()]
    path = tmp_path / "flipped.mcap"
    for place in places:
        data = bytearray(sample.data)
        data[place] ^= 1 << int(rng.integers(8))
        recording = damaged(path, bytes(data))
        assert recording.rig_toml == sample.whole.rig_toml, place
        assert_costs_at_most_its_chunk(sample, recording, place)


def test_a_flipped_bit_in_a_file_never_closed_costs_at_most_its_chunk(
    sample: Sample, tmp_path: Path
) -> None:
    rng = np.random.default_rng(13)
    path = tmp_path / "flipped.mcap"
    end = sample.data_end - 13
    for place in rng.integers(0, end, 120).tolist():
        data = bytearray(sample.data[:end])
        data[place] ^= 1 << int(rng.integers(8))
        recording = damaged(path, bytes(data))
        assert_costs_at_most_its_chunk(sample, recording, place)


def test_several_damaged_chunks_are_skipped_one_by_one(sample: Sample, tmp_path: Path) -> None:
    data = bytearray(sample.data)
    (first, _, _), (_, _, middle), (third, _, _), _ = sample.chunks
    data[first + 80] ^= 0xFF
    data[third + 3] ^= 0xFF  # its length
    recording = damaged(tmp_path / "a.mcap", bytes(data))
    assert counts_of(recording) == middle
    assert recording.rig_toml == sample.whole.rig_toml
    assert len(recording.damage) == 2
    assert recording.damage[0].startswith(f"byte {first}: a chunk ")
    assert recording.damage[1].startswith(f"byte {third}: a record of ")


def test_a_zero_filled_tail_costs_only_what_it_covers(sample: Sample, tmp_path: Path) -> None:
    keep = sample.chunks[1][1] + 5
    recording = damaged(tmp_path / "a.mcap", sample.data[:keep] + bytes(3_000_000))
    assert counts_of(recording) == sample.counts(lambda _, end: end <= keep)


def test_a_hole_in_the_file_costs_only_what_it_covers(sample: Sample, tmp_path: Path) -> None:
    start, end, _ = sample.chunks[1]
    data = sample.data[: start - 10] + bytes(end - start + 20) + sample.data[end + 10 :]
    recording = damaged(tmp_path / "a.mcap", data)
    assert counts_of(recording) == sample.counts(lambda first, _: first != start)


def test_a_lost_beginning_costs_only_what_it_covers(sample: Sample, tmp_path: Path) -> None:
    """As where the first page of a file never reached the disk."""
    for end in (8, 512, 4096, sample.chunks[0][0] - 1):
        for data in (sample.data, sample.data[: sample.chunks[2][1] + 30]):
            recording = damaged(tmp_path / "a.mcap", bytes(end) + data[end:])
            size = len(data)
            kept = sample.counts(lambda start, stop, end=end, size=size: end < start < stop < size)
            assert counts_of(recording) == kept
            assert recording.rig_toml == sample.whole.rig_toml


def test_bytes_behind_the_end_are_told(sample: Sample, tmp_path: Path) -> None:
    recording = damaged(tmp_path / "a.mcap", sample.data + b"x")
    assert counts_of(recording) == counts_of(sample.whole)


def test_private_records_are_passed_over(sample: Sample, tmp_path: Path) -> None:
    """They are legal MCAP. The file's CRCs are taken out, because they cover them."""
    at = sample.chunks[1][0]
    private = b"\x90" + (2_500_000).to_bytes(8, "little") + bytes(2_500_000)
    end = sample.data_end
    footer = b"\x02" + (20).to_bytes(8, "little") + bytes(20)
    data = sample.data[:at] + private + sample.data[at : end - 4] + bytes(4) + footer + MAGIC
    (tmp_path / "a.mcap").write_bytes(data)
    recording = read_recording(tmp_path / "a.mcap")
    assert counts_of(recording) == counts_of(sample.whole)


def test_a_channel_defined_twice_in_two_ways_is_told(
    tmp_path: Path, rig_toml: str, sample: Sample
) -> None:
    """A changed topic in a file without CRCs must not pass for another channel."""
    content = b"\x01\x00\x01\x00" + b"\x0b\0\0\0/channel/q2" + b"\x08\0\0\0protobuf" + bytes(4)
    second = b"\x04" + len(content).to_bytes(8, "little") + content
    at = sample.chunks[1][0]
    recording = damaged(tmp_path / "a.mcap", sample.data[:at] + second + sample.data[at:])
    assert any("second definition" in line for line in recording.damage)
    assert counts_of(recording) == counts_of(sample.whole)


def chunk(data: bytes, size: int, compression: bytes = b"zstd") -> bytes:
    content = bytes(16) + size.to_bytes(8, "little") + bytes(4)
    content += len(compression).to_bytes(4, "little") + compression
    content += len(data).to_bytes(8, "little") + data
    return b"\x06" + len(content).to_bytes(8, "little") + content


HUGE = 2**60
CLAIMS_HUGE = b"\x28\xb5\x2f\xfd" + b"\xe0" + HUGE.to_bytes(8, "little") + bytes(40)
HOSTILE = {
    "record": b"\x06" + HUGE.to_bytes(8, "little"),
    "private record": b"\x99" + HUGE.to_bytes(8, "little"),
    "attachment": b"\x09" + (24).to_bytes(8, "little") + bytes(16) + b"\xff\xff\xff\xff" + bytes(4),
    "chunk size": chunk(zstandard.compress(b"abc"), HUGE),
    "chunk size a bit too large": chunk(zstandard.compress(b"abc"), 200_000_000),
    "zstd frame size": chunk(CLAIMS_HUGE, 100),
    "zstd bomb": chunk(zstandard.compress(bytes(100_000_000)), 100),
    "zstd bomb of no stated size": chunk(
        zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100_000_000)), 100
    ),
    "lz4 bomb": chunk(lz4.frame.compress(bytes(100_000_000)), 100, b"lz4"),
    "lz4 too short": chunk(lz4.frame.compress(b"abc"), 200_000_000, b"lz4"),
    "lz4 cut": chunk(lz4.frame.compress(bytes(1000))[:-8], 1000, b"lz4"),
    "lz4 nonsense": chunk(b"nonsense", 8, b"lz4"),
    "zstd nothing": chunk(b"", 10),
    "unknown compression": chunk(b"abc", 3, b"snappy"),
    "plain chunk of the wrong size": chunk(b"abc", 200_000_000, b""),
    "half a record in a chunk": chunk(b"\x05\x30\0\0\0\0\0\0\0abc", 12, b""),
    "huge record in a chunk": chunk(b"\x05" + HUGE.to_bytes(8, "little") + b"abc", 12, b""),
    "malformed channel in a chunk": chunk(b"\x04\x02\0\0\0\0\0\0\0ab", 11, b""),
    "message of no channel": chunk(b"\x05\x16\0\0\0\0\0\0\0" + bytes(22), 31, b""),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_lengths_take_no_memory_and_cost_nothing_else(
    sample: Sample, tmp_path: Path, name: str
) -> None:
    at = sample.chunks[1][0]
    data = sample.data[:at] + HOSTILE[name] + sample.data[at:]
    recording = damaged(tmp_path / "a.mcap", data)
    assert counts_of(recording) == counts_of(sample.whole)
    tracemalloc.start()
    try:
        read_recording(tmp_path / "a.mcap", damaged_ok=True)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20_000_000


@given(st.binary(max_size=300), st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_bytes_end_in_one_clear_error(tmp_path: Path, tail: bytes, with_header: bool) -> None:
    header = b"\x01" + (15).to_bytes(8, "little") + b"\x07\0\0\0loopcal" + bytes(4)
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + (header if with_header else b"") + tail)
    with pytest.raises((NotARecording, DamagedRecording)):
        read_recording(path, damaged_ok=True)


@given(st.integers(0, 10**6), st.binary(min_size=1, max_size=30))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_bytes_anywhere_never_give_a_wrong_number(
    sample: Sample, tmp_path: Path, place: int, patch: bytes
) -> None:
    place %= len(sample.data)
    data = sample.data[:place] + patch + sample.data[place + len(patch) :]
    path = tmp_path / "patched.mcap"
    path.write_bytes(data)
    try:
        recording = read_recording(path, damaged_ok=True)
    except RecordingsError:
        return
    assert counts_of(recording) <= counts_of(sample.whole)
    assert recording.damage or data == sample.data


def test_the_message_of_a_damaged_file_is_short(
    tmp_path: Path, rig_toml: str, session: Session
) -> None:
    path = tmp_path / "a.mcap"
    places = []
    with Writer(path, rig_toml, session) as writer:
        for i in range(20):
            places.append(path.stat().st_size + 60)
            writer.write(Reading("q1", session.start_ns + i, i))
            writer.flush()
    data = bytearray(path.read_bytes())
    for place in places:
        data[place] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(DamagedRecording, match=r"; and 15 more\. What can still be read: no rea"):
        read_recording(path)


def test_crc_of_the_sample_is_checked_by_hand(sample: Sample) -> None:
    """The data section's CRC is that of all its bytes, as the MCAP specification has it."""
    stated = int.from_bytes(sample.data[sample.data_end - 4 : sample.data_end], "little")
    assert stated == zlib.crc32(sample.data[: sample.data_end - 13])
