"""What of a recording is damaged, missing, or lost on its way: findings.

Owns what is weighed against what: the numbers of the messages against those that are there, the
ledger against both, and the devices' own counters. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator

from recordings.codec import KINDS, READING
from recordings.events import LedgerEntry
from recordings.finding import Finding, Severity
from recordings.survey import Survey
from recordings.wording import between, counted, listed

_SHOWN = 3

_LEDGER = next(kind for kind in KINDS if kind.event is LedgerEntry)


def files(found: Survey) -> Iterator[Finding]:
    """Files that were never closed, are damaged, or are not there."""
    harm: list[tuple[str, str]] = []
    for file in found.files:
        if not file.closed:
            text = f"'{file.path.name}' was never closed, or its end is cut off: "
            text += "what was not flushed when its writer was killed or lost power is lost"
            harm.append(("never-closed", text))
        places = [str(each) for each in file.damage if file.closed or each.offset < file.size]
        if places:
            more = f"; and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
            text = f"'{file.path.name}' is damaged in {counted(len(places), 'place')}: "
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


def rig(found: Survey) -> Iterator[Finding]:
    """A rig description that is lost or wrong."""
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
        where = ", ".join(between(found, hole.after_ns, hole.before_ns) for hole in holes[:_SHOWN])
        more = f" and {len(holes) - _SHOWN} more places" if len(holes) > _SHOWN else ""
        subject = READING.subject_of(topic)
        kind = "reading" if subject else "message"
        alike.setdefault((tally.missing, kind, where + more), []).append(subject or topic)
    for (count, kind, where), names in alike.items():
        each = " each" if len(names) > 1 else ""
        yield f"{listed(names)}: {counted(count, kind)}{each}, {where}"


def gone(found: Survey) -> Iterator[Finding]:
    """Messages that were written and are not there any more."""
    # What a recovery could not save is known, and no news.
    recovered = bool(found.recovery) and not found.damage
    severity = Severity.CAUTION if recovered else Severity.BAD
    for line in missing(found):
        yield Finding(severity, "missing", f"written, but not in the file any more: {line}")
    lost = [topic for topic, tally in found.topics.items() if tally.missing is None]
    if lost and found.damage:
        text = f"how much is missing of {listed(lost)} cannot be told: nothing counts its messages"
        yield Finding(Severity.CAUTION, "uncounted", text)
    if found.undeclared:
        yield Finding(
            Severity.BAD,
            "undeclared",
            f"{counted(found.undeclared, 'message')} cannot be read: their channel's definition is lost",
        )


def ledger(found: Survey) -> Iterator[Finding]:
    """What was lost before it reached the file, and counts that do not agree."""
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
        text = f"no ledger for {listed(silent)}: what was lost on the way to the file is not known"
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
        (entry.lost_in_gaps, f"in {counted(entry.gaps, 'gap')}", "check plugs and power"),
    ):
        if lost:
            text = f"{entry.source}: {lost} of {entry.expected} readings were lost {where}"
            yield Finding(Severity.CAUTION, "losses", text, remedy)


def _before(found: Survey, channel: str) -> int:
    return found.files[0].part.received_before.get(channel, 0)
