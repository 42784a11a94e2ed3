"""Position PDOs to readings: bytes pinned, counters that wrap, samples that are missing."""

from __future__ import annotations

import pytest

from drivers.canopen.encoder import Sample, SampleTrack, decode
from drivers.errors import Malformed
from drivers.link import Losses
from drivers.tally import Tally
from recordings.events import ReadingFlag

MS = 1_000_000


@pytest.mark.parametrize(
    ("data", "sample"),
    [
        ("40 0D 03 00 FF FF 10 27", Sample(200_000, 65535, 10_000)),
        ("FF FF FF FF 00 00 00 00", Sample(4_294_967_295, 0, 0)),
        ("40 0D 03 00", Sample(200_000, None, None)),
        ("40 0D 03 00 07 00", Sample(200_000, 7, None)),
    ],
)
def test_position_pdos(data: str, sample: Sample):
    assert decode(bytes.fromhex(data)) == sample


@pytest.mark.parametrize("data", ["", "40 0D 03"])
def test_a_pdo_without_a_whole_position_is_malformed(data: str):
    with pytest.raises(Malformed, match="expected 4 to 8"):
        decode(bytes.fromhex(data))


@pytest.fixture
def tally() -> Tally:
    tally = Tally()
    tally.ask(times=100)
    return tally


def test_readings_carry_sequence_and_device_time_across_their_wraps(tally: Tally):
    track = SampleTrack("q1", tally)
    before = track.reading(Sample(5, 65535, 65500), 1000 * MS)
    after = track.reading(Sample(6, 0, 64), 1010 * MS)
    assert (before.sequence, after.sequence) == (65535, 65536)
    assert before.device_time_ns is not None
    assert after.device_time_ns == before.device_time_ns + 100 * 100_000
    assert after.time_ns == 1010 * MS


def test_device_time_survives_a_pause_longer_than_its_wrap(tally: Tally):
    track = SampleTrack("q1", tally)
    first = track.reading(Sample(5, 1, 0), 0)
    pause_ms = 20_000
    after = track.reading(Sample(5, 2, pause_ms * 10 % 65536), (pause_ms + 1) * MS)
    assert after.device_time_ns - first.device_time_ns == pause_ms * MS


def test_a_step_of_the_counter_is_counted_as_lost(tally: Tally):
    track = SampleTrack("q1", tally)
    for counter in (65534, 65535, 3):
        track.reading(Sample(0, counter, None), 0)
    assert tally.losses().lost_in_gaps == 3
    assert tally.losses().gaps == 1


def test_the_first_counter_value_tells_nothing_about_losses():
    tally = Tally()
    tally.ask(times=10)
    SampleTrack("q1", tally).reading(Sample(0, 4000, None), 0)
    assert tally.losses().lost_in_gaps == 0


def test_a_sample_sent_twice_is_stale_and_pays_for_no_other():
    tally = Tally()
    track = SampleTrack("q1", tally)
    tally.ask(times=2)
    first = track.reading(Sample(0, 1, None), 0)
    again = track.reading(Sample(0, 1, None), 1)
    assert (first.flags, again.flags) == (ReadingFlag.NONE, ReadingFlag.STALE)
    tally.give_up()
    assert tally.losses() == Losses(3, 1, 0, 0)


def test_a_restarted_device_counts_from_zero_without_a_loss(tally: Tally):
    track = SampleTrack("q1", tally)
    track.reading(Sample(0, 500, 9000), 0)
    track.restart()
    reading = track.reading(Sample(0, 0, 3), 1)
    assert (reading.sequence, reading.device_time_ns) == (0, 300_000)
    assert tally.losses().lost_in_gaps == 0


def test_an_encoder_without_counter_and_clock_says_so(tally: Tally):
    reading = SampleTrack("q1", tally).reading(Sample(9, None, None), 0)
    assert (reading.raw, reading.sequence, reading.device_time_ns) == (9, None, None)
