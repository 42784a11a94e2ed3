"""The fault matrix: every trouble of `drivers.detection` with every driver, measured and written.

    python -m tests.faults.matrix      # writes docs/fault-matrix.md again

All figures are by the virtual clock of a bench in memory with seeded noise, so that they are
the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.detection import DETECTION, SAMPLE_HZ, Detected, Trouble
from recordings.events import ReadingFlag
from recordings.faults import ENDED_BY, FaultKind
from tests.faults.bench import CASES, Outcome, run

PAGE = Path(__file__).parents[2] / "docs" / "fault-matrix.md"
BEGIN_S = 1.0
AFTER_S = 2.5
"""How long a session goes on after the fault: the longest way back, and the end of every episode."""


@dataclass(frozen=True, slots=True)
class Script:
    """What is done to the device called "device" on the port called "port".

    Attributes:
        line: line of a fault script, without its time.
        lasts_s: how long it lasts, 0 for what happens once.
    """

    line: str
    lasts_s: float = 1.0

    @property
    def text(self) -> str:
        """The whole line."""
        lasting = f" for {self.lasts_s:g} s" if self.lasts_s else ""
        return f"at {BEGIN_S:g} s {self.line}{lasting}"

    @property
    def end_s(self) -> float:
        """When it is over."""
        return BEGIN_S + self.lasts_s


SCRIPTS: Mapping[Trouble, Script] = {
    Trouble.UNPLUG: Script("unplug port"),
    Trouble.BUS_OFF: Script("bus-off port"),
    Trouble.SILENCE: Script("silence device", 2.0),
    Trouble.BABBLE: Script("babble port 6000 /s"),
    Trouble.STUCK: Script("stick device", 2.0),
    Trouble.WRONG_ID: Script("renumber device to 9"),
    Trouble.DUPLICATE: Script("duplicate device", 2.0),
    Trouble.CHECKSUM: Script("corrupt port 30 %"),
    Trouble.LATE: Script("delay device 150 ms"),
    Trouble.FOREIGN: Script("foreign device"),
    Trouble.GAPS: Script("drop device 20 %"),
    Trouble.RESTART: Script("restart device", 0.0),
}
UNTRUSTED = int(ReadingFlag.STALE | ReadingFlag.DEVICE_ERROR)


@dataclass(frozen=True, slots=True)
class Cell:
    """One trouble with one driver.

    Attributes:
        driver: driver name.
        trouble: what went wrong.
        promise: how `drivers.detection` says that it is noticed.
        outcome: what the session saw.
        kind: kind of the first fault that was promised, None where none came.
        detected_s: time from the beginning of the trouble to that fault.
        recovered_s: time from the end of the trouble to the last end of an episode that is more
            than a wait for quiet, or to the first trusted reading, whichever is later.
    """

    driver: str
    trouble: Trouble
    promise: Detected
    outcome: Outcome
    kind: FaultKind | None
    detected_s: float
    recovered_s: float

    @property
    def lost(self) -> int:
        """Readings that should have come and did not."""
        return self.outcome.ledger.expected - self.outcome.ledger.received

    @property
    def accounted(self) -> int:
        """Of those, the ones of which the ledger says where they went."""
        ledger = self.outcome.ledger
        return ledger.dropped_by_device + ledger.dropped_by_host + ledger.lost_in_gaps


def cells() -> Iterator[tuple[str, Trouble]]:
    """Every driver with every trouble that it can meet."""
    for driver in CASES:
        for trouble, promise in DETECTION[driver].items():
            if isinstance(promise, Detected):
                yield driver, trouble


def measure(driver: str, trouble: Trouble) -> Cell:
    """Let ``trouble`` happen to one device of ``driver``."""
    promise = DETECTION[driver][trouble]
    assert isinstance(promise, Detected), f"{driver} does not meet {trouble}"
    script = SCRIPTS[trouble]
    outcome = run(driver, script.text, script.end_s + AFTER_S)
    noticed = [
        (outcome.seconds(fault.time_ns), FaultKind(fault.kind))
        for fault in outcome.faults
        if fault.kind in promise.kinds and outcome.seconds(fault.time_ns) >= BEGIN_S
    ]
    at_s, kind = noticed[0] if noticed else (math.inf, None)
    return Cell(
        driver=driver,
        trouble=trouble,
        promise=promise,
        outcome=outcome,
        kind=kind,
        detected_s=at_s - BEGIN_S,
        recovered_s=max(_trusted_again_s(outcome, script.end_s), _answers_again_s(outcome, script))
        - script.end_s,
    )


# Ends that are reported when nothing has happened for a while: the trouble was over before.
_WAITED_FOR = {
    FaultKind.LOSING,
    FaultKind.DUPLICATED,
    FaultKind.BABBLE,
    FaultKind.FOREIGN,
    FaultKind.MALFORMED,
    FaultKind.LATE,
    FaultKind.BUS_ERROR,
}


def _trusted_again_s(outcome: Outcome, end_s: float) -> float:
    """Time of the first reading after the trouble from which on all can be trusted."""
    doubtful = [time_s for time_s, flags in outcome.readings if flags & UNTRUSTED]
    since_s = max([end_s, *doubtful])
    return next((time_s for time_s, _ in outcome.readings if time_s > since_s), math.inf)


def _answers_again_s(outcome: Outcome, script: Script) -> float:
    ends = [
        outcome.seconds(episode.end_ns)
        for episode in outcome.episodes
        if episode.end_ns is not None
        and episode.kind in ENDED_BY
        and episode.kind not in _WAITED_FOR
    ]
    return max([script.end_s, *ends])


def page(measured: Mapping[tuple[str, Trouble], Cell]) -> str:
    """The page: the matrix, and what stands behind each of its cells."""
    drivers = list(CASES)
    text = [HEAD, "", f"| | {' | '.join(drivers)} |", "|---" * (len(drivers) + 1) + "|"]
    for trouble in Trouble:
        row = [_short(measured.get((driver, trouble))) for driver in drivers]
        text.append(f"| {trouble} | {' | '.join(row)} |")
    text += ["", "Detected after / recovered after [s]; – cannot occur, see below.", ""]
    for driver in drivers:
        text += [f"## {driver}", "", COLUMNS, "|---|---|---|--:|--:|--:|--:|--:|--:|"]
        for trouble in Trouble:
            text.append(_row(driver, trouble, measured))
        text.append("")
    return "\n".join(text)


WIRED: Mapping[str, str] = {
    "canopen-encoder": "unplug, bus-off, silence and restart",
    "modbus-adc": "unplug, silence, checksum errors and foreign replies",
    "cobs-adc": "unplug and checksum errors",
    "modbus-adc over TCP": "unplug and foreign replies",
}
"""What `tests/faults/test_wires.py` plays."""

HEAD = f"""# Fault matrix

Every fault of the wire with every driver: how soon it is noticed and as what, how soon readings
can be trusted again, and how many were lost. Written by `python -m tests.faults.matrix` from
sessions of the real drivers with virtual devices, sampling at {SAMPLE_HZ:g} Hz, by a virtual clock
and with seeded noise: the figures are the same on every machine. The tests compare them with
this page, and with what `drivers/detection.py` promises. [How to write such scripts](howto-faults.md).

Some of the cells are played over real ports and in real time as well (tests marked `wires`): over
pseudo-terminals {WIRED["canopen-encoder"]} of canopen-encoder and {WIRED["modbus-adc"]} of modbus-adc,
{WIRED["cobs-adc"]} of cobs-adc, and over TCP {WIRED["modbus-adc over TCP"]} of modbus-adc.

Each fault begins after {BEGIN_S:g} s and is recorded with its end. Where a port is away, it is tried
again after 0.25, 0.5, 1, 2 and then every 4 s; recovery takes as long as the wait for the next try."""

COLUMNS = (
    "| fault | script | noticed as | promised [s] | detected [s] | recovered [s] "
    "| lost | accounted | unaccounted |"
)


def _short(cell: Cell | None) -> str:
    return "–" if cell is None else f"{cell.detected_s:.2f} / {cell.recovered_s:.2f}"


def _row(driver: str, trouble: Trouble, measured: Mapping[tuple[str, Trouble], Cell]) -> str:
    promise = DETECTION[driver][trouble]
    if isinstance(promise, str):
        return f"| {trouble} | | cannot occur: {promise} | | | | | | |"
    cell = measured[driver, trouble]
    figures = (
        f"{promise.within_s:.2f}",
        f"{cell.detected_s:.2f}",
        f"{cell.recovered_s:.2f}",
        str(cell.lost),
        str(cell.accounted),
        str(cell.outcome.ledger.unaccounted),
    )
    kinds = dict.fromkeys(episode.kind for episode in cell.outcome.episodes)
    kinds.pop(str(cell.kind), None)
    seen = ", ".join([f"**{cell.kind}**", *kinds])
    return f"| {trouble} | `{SCRIPTS[trouble].text}` | {seen} | {' | '.join(figures)} |"


def main() -> None:
    """Measure everything and write the page."""
    from rich.progress import track

    measured = {
        (driver, trouble): measure(driver, trouble)
        for driver, trouble in track(list(cells()), description="fault matrix")
    }
    PAGE.write_text(page(measured), "utf-8")


if __name__ == "__main__":
    main()
