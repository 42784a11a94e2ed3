"""What is to be thought of a recording: findings in words, each with what to do about it.

Owns the limits beyond which something is worth telling. Pure: it looks at a survey only.
Moments are told in seconds since the recording's first message.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from recordings.codec import KINDS, READING
from recordings.events import LedgerEntry, ReadingFlag
from recordings.survey import Survey

_SECOND = 1_000_000_000
_SILENCE_NS = 1 * _SECOND
_SILENT_INTERVALS = 20  # typical intervals that make a silence
_SAME_NS = 20 * _SECOND
_SAME_SHARE = 0.3  # of the recording
_FEWEST = 10  # readings from which a channel can be called stuck
_START_NS = 3600 * _SECOND
_CLOCK_NS = 20_000_000  # jump of a device clock's offset that no drift explains
_SHOWN = 3

_LEDGER = next(kind for kind in KINDS if kind.event is LedgerEntry)

_FLAGS = {
    ReadingFlag.OVERRANGE: ("over range", "check the sensor's range and its wiring"),
    ReadingFlag.STALE: ("stale", "the device repeats old values; sample it more slowly"),
    ReadingFlag.DEVICE_ERROR: ("marked as errors by the device", "see the device's manual"),
}


class Severity(StrEnum):
    """How much a finding matters."""

    BAD = "bad"
    """Something is lost or wrong that should not be."""
    CAUTION = "caution"
    """Known and accounted for, or only suspicious: look before you rely on it."""
    NOTE = "note"
    """Worth knowing."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing about a recording.

    Attributes:
        severity: how much it matters.
        kind: its name, for programs.
        text: what was found.
        remedy: what to do, or "" where nothing is to be done.
    """

    severity: Severity
    kind: str
    text: str
    remedy: str = ""


def findings(found: Survey) -> tuple[Finding, ...]:
    """All that is to be said of a recording, what matters most first."""
    checks = (_files, _rig, _missing, _ledger, _time, _silences, _values, _session)
    all_found = [finding for check in checks for finding in check(found)]
    order = list(Severity)
    return tuple(sorted(all_found, key=lambda finding: order.index(finding.severity)))


def start_ns(found: Survey) -> int:
    """Time of the earliest message; 0 in a recording without any."""
    return min((tally.first_ns for tally in found.topics.values() if tally.count), default=0)


def end_ns(found: Survey) -> int:
    """Time of the latest message; 0 in a recording without any."""
    return max((tally.last_ns for tally in found.topics.values() if tally.count), default=0)


def _files(found: Survey) -> Iterator[Finding]:
    harm: list[tuple[str, str]] = []
    for file in found.files:
        if not file.closed:
            text = f"'{file.path.name}' was never closed, or its end is cut off: "
            text += "what was not flushed when its writer was killed or lost power is lost"
            harm.append(("never-closed", text))
        places = [str(each) for each in file.damage if file.closed or each.offset < file.size]
        if places:
            more = f"; and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
            text = f"'{file.path.name}' is damaged in {_count(len(places), 'place')}: "
            harm.append(("damaged", text + "; ".join(places[:_SHOWN]) + more))
    repair = f"`loopcal recover {found.files[0].path} -o NEW.mcap` saves what can be read"
    for kind, text in harm:
        yield Finding(Severity.BAD, kind, text, repair if text == harm[-1][1] else "")
    if found.missing_part:
        remedy = f"put all parts beside '{found.files[0].path.name}'"
        yield Finding(Severity.BAD, "part-missing", found.missing_part, remedy)
    if found.recovery:
        source = found.recovery.get("source", "")
        yield Finding(Severity.NOTE, "recovered", f"it was recovered from the damaged '{source}'")


def _rig(found: Survey) -> Iterator[Finding]:
    if found.rig_toml is None:
        yield Finding(
            Severity.BAD,
            "rig-lost",
            "its rig description is lost, and without one it cannot be solved",
            "give the rig file: `loopcal recover ... --rig RIG`",
        )
    elif found.rig is None:
        yield Finding(Severity.BAD, "rig-invalid", found.rig_error, "correct it and import again")


def missing(found: Survey) -> Iterator[str]:
    """What is missing by the numbers of the messages, alike channels in one line."""
    alike: dict[tuple[int, str, str], list[str]] = {}
    for topic, tally in found.topics.items():
        # Of a ledger the last entry counts, whatever is missing before it.
        if not tally.missing or _LEDGER.subject_of(topic) is not None:
            continue
        holes = sorted(tally.holes, key=lambda hole: -hole.count)
        where = ", ".join(_hole(found, hole.after_ns, hole.before_ns) for hole in holes[:_SHOWN])
        more = f" and {len(holes) - _SHOWN} more places" if len(holes) > _SHOWN else ""
        subject = READING.subject_of(topic)
        kind = "reading" if subject else "message"
        alike.setdefault((tally.missing, kind, where + more), []).append(subject or topic)
    for (count, kind, where), names in alike.items():
        each = " each" if len(names) > 1 else ""
        yield f"{_list(names)}: {_count(count, kind)}{each}, {where}"


def _missing(found: Survey) -> Iterator[Finding]:
    # What a recovery could not save is known, and no news.
    recovered = bool(found.recovery) and not found.damage
    severity = Severity.CAUTION if recovered else Severity.BAD
    for line in missing(found):
        yield Finding(severity, "missing", f"written, but not in the file any more: {line}")
    lost = [topic for topic, tally in found.topics.items() if tally.missing is None]
    if lost and found.damage:
        text = f"how much is missing of {_list(lost)} cannot be told: nothing counts its messages"
        yield Finding(Severity.CAUTION, "uncounted", text)
    if found.undeclared:
        yield Finding(
            Severity.BAD,
            "undeclared",
            f"{_count(found.undeclared, 'message')} cannot be read: their channel's definition is lost",
        )


def _ledger(found: Survey) -> Iterator[Finding]:
    names = [] if found.rig is None else [channel.name for channel in found.rig.channels]
    for name in names:
        tally, entry = found.channel(name), found.ledger.get(name)
        if entry is None:
            continue
        yield from _balance(entry)
        present = tally.count + _before(found, name) + (tally.missing or 0)
        if entry.received > present or (not found.damage and entry.received < present):
            yield Finding(
                Severity.BAD,
                "ledger-mismatch",
                f"{name}: the ledger counts {entry.received} readings received, the file has {present}",
                "do not rely on its counts of losses",
            )
        skipped = found.readings[name].skipped if name in found.readings else None
        known = entry.expected - entry.received + (tally.missing or 0)
        if skipped is not None and skipped > known:
            yield Finding(
                Severity.BAD,
                "device-counter",
                f"{name}: the device's counter leaves out {skipped} samples, of which the ledger "
                f"knows {known}",
                "losses between device and host; lower the rate, check the bus",
            )
    silent = [name for name in names if name in found.readings and name not in found.ledger]
    if silent:
        text = f"no ledger for {_list(silent)}: what was lost on the way to the file is not known"
        yield Finding(Severity.NOTE, "no-ledger", text)


def _balance(entry: LedgerEntry) -> Iterator[Finding]:
    if entry.unaccounted:
        yield Finding(
            Severity.BAD,
            "unaccounted",
            f"{entry.source}: {abs(entry.unaccounted)} of {entry.expected} expected readings are "
            + ("unaccounted for" if entry.unaccounted > 0 else "accounted for twice"),
            "check the device's rate and counter; report it if they are right",
        )
    for lost, where, remedy in (
        (entry.dropped_by_device, "by the device or its bus", "lower the rate, check the bus"),
        (entry.dropped_by_host, "by this computer", "a faster disk, or a lower rate"),
        (entry.lost_in_gaps, f"in {_count(entry.gaps, 'gap')}", "check plugs and power"),
    ):
        if lost:
            text = f"{entry.source}: {lost} of {entry.expected} readings were lost {where}"
            yield Finding(Severity.CAUTION, "losses", text, remedy)


def _time(found: Survey) -> Iterator[Finding]:
    back = {topic: tally for topic, tally in found.topics.items() if tally.backwards}
    if back:
        times = max(tally.backwards for tally in back.values())
        most = max(tally.furthest_back_ns for tally in back.values()) / _SECOND
        text = (
            f"time goes back {_count(times, 'time')}, by up to {most:.3f} s, in "
            f"{_list([READING.subject_of(topic) or topic for topic in back])}: readers sort by "
            "time, and mix what was recorded before with what came after"
        )
        remedy = "record with a clock that is never set"
        yield Finding(Severity.BAD, "time-back", text, remedy)
    began = found.session.start_ns
    if began and start_ns(found) and abs(start_ns(found) - began) > _START_NS:
        hours = (start_ns(found) - began) / _SECOND / 3600
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
        text = f"the clock of {source} jumped {_count(count, 'time')}: the device restarted, or was set"
        yield Finding(Severity.CAUTION, "clock", text, "do not rely on its device times across it")


def _silences(found: Survey) -> Iterator[Finding]:
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
            f"all channels are silent for {(end - begin) / _SECOND:.1f} s, at {_at(found, begin)}"
        )
        remedy = "the computer slept, its clock was set, or all devices were away"
        yield Finding(Severity.CAUTION, "silence", text, remedy)
        return
    for name, (at, length, count) in longest.items():
        often = f" (and {_count(count - 1, 'shorter silence')})" if count > 1 else ""
        text = f"{name}: no reading for {length / _SECOND:.1f} s, at {_at(found, at)}{often}"
        yield Finding(Severity.CAUTION, "silence", text, "see the faults there; check the plug")


def _values(found: Survey) -> Iterator[Finding]:
    names = [] if found.rig is None else [channel.name for channel in found.rig.channels]
    empty = [name for name in names if name not in found.readings]
    if empty:
        what = (
            "no channel has" if len(empty) == len(names) else f"{_list(empty)}: the rig has it, but"
        )
        severity = Severity.BAD if len(empty) == len(names) else Severity.CAUTION
        yield Finding(
            severity,
            "no-readings",
            f"{what} no readings" if len(empty) < len(names) else "no channel has readings",
        )
    span = end_ns(found) - start_ns(found)
    for name, tally in found.readings.items():
        count = found.channel(name).count
        same_ns = tally.same_until_ns - tally.same_since_ns
        if tally.low == tally.high and count >= _FEWEST:
            text = f"{name}: all {count} readings are {tally.low}"
        elif same_ns > max(_SAME_NS, _SAME_SHARE * span):
            text = (
                f"{name}: {tally.same} readings in a row are equal, {same_ns / _SECOND:.1f} s "
                f"from {_at(found, tally.same_since_ns)} on"
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
                Severity.CAUTION, "flagged", f"{name}: {_count(flagged, 'reading')} {what}", remedy
            )


def _session(found: Survey) -> Iterator[Finding]:
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
        text = (
            f"{_count(len(found.faults), 'fault')} during the session: {', '.join(shown[:6])}{more}"
        )
        yield Finding(Severity.CAUTION, "faults", text, "`loopcal info` lists them")
    for mark in found.marks:
        if mark.text.startswith("session failed"):
            yield Finding(Severity.CAUTION, "failed", f"the {mark.text}")


def _before(found: Survey, channel: str) -> int:
    return found.files[0].part.received_before.get(channel, 0)


def _at(found: Survey, time_ns: int) -> str:
    return f"{(time_ns - start_ns(found)) / _SECOND:.1f} s"


def _hole(found: Survey, after_ns: int | None, before_ns: int | None) -> str:
    if after_ns is None and before_ns is None:
        return "all"
    if after_ns is None:
        return f"before {_at(found, before_ns or 0)}"
    if before_ns is None:
        return f"after {_at(found, after_ns)}"
    return f"{_at(found, after_ns)} to {_at(found, before_ns)}"


def _count(count: int, what: str) -> str:
    return f"{count} {what}" + ("" if count == 1 else "s")


def _list(names: list[str]) -> str:
    more = len(names) - 8
    return ", ".join(names[:8]) + (f" and {more} more" if more > 0 else "")
