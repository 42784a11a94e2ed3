"""What bounds the age of a reading, and the skew between devices and ports."""

from __future__ import annotations

from recordings.events import ClockSample, RoundTrip
from recordings.rig import load_rig
from recordings.timing import DeviceTiming, port_skews, skew, timings


def device(name: str, port: str, clock_ns: int | None, *trip: int) -> DeviceTiming:
    clock = None if clock_ns is None else ClockSample(name, 0, 0, 0, clock_ns)
    shortest, longest = trip or (None, None)
    return DeviceTiming(name, port, (), clock, shortest, longest)


ASKED = device("adc", "serial", None, 2_000, 9_000)
CLOCKED = device("encoder", "can", 50, 1_000, 7_000)
STREAM = device("stream", "other", 10)


def test_a_reading_is_no_older_than_its_round_trip_or_with_a_clock_the_shortest() -> None:
    assert ASKED.oldest_ns == 9_000
    assert CLOCKED.oldest_ns == 1_100
    assert STREAM.oldest_ns is None


def test_the_skew_of_two_devices_is_an_interval() -> None:
    assert skew(CLOCKED, ASKED) == (-9_000, 1_100)
    assert skew(ASKED, CLOCKED) == (-1_100, 9_000)
    assert skew(STREAM, ASKED) == (-9_000, None)


def test_the_skew_of_two_ports_is_that_of_their_worst_devices() -> None:
    worse = device("worse", "can", None, 3_000, 4_000)
    (only,) = port_skews([CLOCKED, worse, ASKED])
    assert (only.first, only.second) == ("can", "serial")
    assert (only.lowest_ns, only.highest_ns) == (-9_000, 4_000)
    assert port_skews([CLOCKED, STREAM])[0].lowest_ns is None


def test_timings_name_every_device_that_delivers() -> None:
    rig = load_rig("arm")
    clock = [ClockSample("encoder1", t, t, 5, t) for t in (1, 2)]
    trips = [RoundTrip("encoder1", 1, 30, 40), RoundTrip("encoder1", 2, 20, 35)]
    found = timings(rig, clock, trips)
    assert [each.device for each in found][:2] == ["encoder1", "encoder2"]
    assert {name for each in found for name in each.channels} == {c.name for c in rig.channels}
    first = found[0]
    assert first.clock == clock[-1]
    assert (first.shortest_ns, first.longest_ns) == (20, 40)
    assert found[1].clock is None
