"""What in a recording looks wrong though all of it is there: findings.

Owns the limits beyond which a clock, a silence, a sensor or a session is worth telling of. Pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from recordings.codec import READING
from recordings.events import ReadingFlag
from recordings.finding import Finding, Severity
from recordings.survey import Survey
from recordings.wording import SECOND, counted, listed, moment

_SILENCE_NS = 1 * SECOND
_SILENT_INTERVALS = 20  # typical intervals that make a silence
_SAME_NS = 20 * SECOND
_SAME_SHARE = 0.3  # of the recording
_FEWEST = 10  # readings from which a channel can be called stuck
_START_NS = 3600 * SECOND
_CLOCK_NS = 20_000_000  # jump of a device clock's offset that no drift explains

_FLAGS = {
    ReadingFlag.OVERRANGE: ("over range", "check the sensor's range and its wiring"),
    ReadingFlag.STALE: ("stale", "the device repeats old values; sample it more slowly"),
    ReadingFlag.DEVICE_ERROR: ("marked as errors by the device", "see the device's manual"),
}


def time(found: Survey) -> Iterator[Finding]:
    """Times that go back, and clocks that jump."""
    back = {topic: tally for topic, tally in found.topics.items() if tally.backwards}
    if back:
        times = max(tally.backwards for tally in back.values())
        most = max(tally.furthest_back_ns for tally in back.values()) / SECOND
        text = (
            f"time goes back {counted(times, 'time')}, by up to {most:.3f} s, in "
            f"{listed([READING.subject_of(topic) or topic for topic in back])}: readers sort by "
            "time, and mix what was recorded before with what came after"
        )
        remedy = "record with a clock that is never set"
        yield Finding(Severity.BAD, "time-back", text, remedy)
    began = found.session.start_ns
    if began and found.start_ns and abs(found.start_ns - began) > _START_NS:
        hours = (found.start_ns - began) / SECOND / 3600
        text = f"the first message is {hours:+.1f} h from the stated start of the session"
        yield Finding(Severity.CAUTION, "clock", text, "check the clock of the computer")
    jumps: Counter[str] = Counter()
    latest: dict[str, int] = {}
    for sample in found.clock:
        before = latest.get(sample.source, sample.offset_ns)
        if abs(sample.offset_ns - before) > max(_CLOCK_NS, 10 * sample.uncertainty_ns):
            jumps[sample.source] += 1
        latest[sample.source] = sample.offset_ns
    for source, count in jumps.items():
        text = f"the clock of {source} jumped {counted(count, 'time')}: the device restarted, or was set"
        yield Finding(Severity.CAUTION, "clock", text, "do not rely on its device times across it")


def silences(found: Survey) -> Iterator[Finding]:
    """Long times without a reading."""
    longest: dict[str, tuple[int, int, int]] = {}
    for name in found.readings:
        tally = found.channel(name)
        limit = max(_SILENCE_NS, _SILENT_INTERVALS * tally.typical_ns)
        holes = {hole.after_ns for hole in tally.holes}  # what is lost there was told already
        long = [(at, ns) for at, ns in tally.silences if ns > limit and at not in holes]
        if long:
            at, length = max(long, key=lambda silence: silence[1])
            longest[name] = (at, length, len(long))
    if not longest:
        return
    begin = max(at for at, _, _ in longest.values())
    end = min(at + length for at, length, _ in longest.values())
    if len(longest) == len(found.readings) > 1 and begin < end:
        text = (
            f"all channels are silent for {(end - begin) / SECOND:.1f} s, at {moment(found, begin)}"
        )
        remedy = "the computer slept, its clock was set, or all devices were away"
        yield Finding(Severity.CAUTION, "silence", text, remedy)
        return
    for name, (at, length, count) in longest.items():
        often = f" (and {counted(count - 1, 'shorter silence')})" if count > 1 else ""
        text = f"{name}: no reading for {length / SECOND:.1f} s, at {moment(found, at)}{often}"
        yield Finding(Severity.CAUTION, "silence", text, "see the faults there; check the plug")


def values(found: Survey) -> Iterator[Finding]:
    """Channels without readings, sensors that are stuck, and what devices flagged."""
    names = [] if found.rig is None else [channel.name for channel in found.rig.channels]
    empty = [name for name in names if name not in found.readings]
    if empty:
        what = (
            "no channel has"
            if len(empty) == len(names)
            else f"{listed(empty)}: the rig has it, but"
        )
        severity = Severity.BAD if len(empty) == len(names) else Severity.CAUTION
        yield Finding(
            severity,
            "no-readings",
            f"{what} no readings" if len(empty) < len(names) else "no channel has readings",
        )
    span = found.end_ns - found.start_ns
    for name, tally in found.readings.items():
        count = found.channel(name).count
        same_ns = tally.same_until_ns - tally.same_since_ns
        if tally.low == tally.high and count >= _FEWEST:
            text = f"{name}: all {count} readings are {tally.low}"
        elif same_ns > max(_SAME_NS, _SAME_SHARE * span):
            text = (
                f"{name}: {tally.same} readings in a row are equal, {same_ns / SECOND:.1f} s "
                f"from {moment(found, tally.same_since_ns)} on"
            )
        else:
            text = ""
        if text:
            yield Finding(
                Severity.CAUTION, "stuck", text, "a stuck sensor, unless its joint was locked"
            )
        for flag, flagged in tally.flags.items():
            what, remedy = _FLAGS.get(flag, ("flagged", ""))
            yield Finding(
                Severity.CAUTION, "flagged", f"{name}: {counted(flagged, 'reading')} {what}", remedy
            )


def session(found: Survey) -> Iterator[Finding]:
    """What happened in the session: no dwells, faults, a bad end."""
    if not found.dwells and found.readings:
        yield Finding(
            Severity.NOTE,
            "no-dwells",
            "no dwells are recorded",
            "a solve looks for standstills in the readings; check how many it finds",
        )
    faults = Counter((fault.source, fault.kind) for fault in found.faults)
    if faults:
        shown = [
            f"{source} {kind}" + (f" ×{n}" if n > 1 else "")
            for (source, kind), n in faults.most_common()
        ]
        more = f" and {len(shown) - 6} more" if len(shown) > 6 else ""
        text = f"{counted(len(found.faults), 'fault')} during the session: {', '.join(shown[:6])}{more}"
        yield Finding(Severity.CAUTION, "faults", text, "`loopcal info` lists them")
    for mark in found.marks:
        if mark.text.startswith("session failed"):
            yield Finding(Severity.CAUTION, "failed", f"the {mark.text}")
