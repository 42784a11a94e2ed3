"""`loopcal capture`: arming, a live view of the session, and what it left behind.

Arming ends by itself. Every line on standard input renews it, so that an operator does so with
the Enter key, and a service that stands in for one by writing a line now and then; where either
is gone, the arming runs out.
"""

from __future__ import annotations

import os
import select
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import typer
from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from daq import Arming, CaptureOptions, CaptureSummary, Ending, Progress, capture
from daq.clock import HostClock
from daq.mobility import Mobility
from drivers import make_links
from loopcal.console import err, out
from loopcal.timing_view import show_timing
from recordings.events import SessionState
from recordings.faults import Episode, episodes
from recordings.rig import Plan, Rig, load_plan, parse_rig, rig_text
from recordings.storage import Storage

SHORT_S = 60.0
"""An arming that lasts no longer than this [s] is shown in red."""


def run_capture(
    name: str,
    output: Path,
    *,
    plan: Path | None,
    poses: int | None,
    ports: Mapping[str, str],
    arm: bool,
    arm_for_s: float | None,
    operator: str,
    notes: str,
    limit_s: float | None,
    storage: Storage,
) -> bool:
    """Run a session in the foreground; whether it ended well (complete, or stopped by the operator)."""
    text, source = rig_text(name)
    rig = parse_rig(text, source)
    clock = HostClock()
    limited = arm_for_s is not None
    arming = Arming(clock, arm_for_s if arm_for_s is not None else rig.interlocks.arming)
    mobility = _mobility(rig)
    with View(arming) as view:
        summary = capture(
            rig,
            text,
            output,
            links=make_links(rig, clock, ports),
            clock=clock,
            arm=(lambda joints: True) if arm else view.ask,
            arming=arming,
            arm_virtual=limited,
            mobility=mobility,
            on_progress=view.show,
            operator=operator,
            notes=notes,
            plan_override=_plan(rig, plan, poses),
            options=CaptureOptions(max_duration_s=limit_s, storage=storage),
        )
    show_summary(summary)
    return summary.ending is not Ending.FAILED


def _mobility(rig: Rig) -> Mobility | None:
    """How the mechanism can move, where there is a drive to move it: else nobody needs to know."""
    if all(device.joint is None for device in rig.devices):
        return None
    from loopcal.loop_mobility import mobility_of  # the solver takes a while to import

    return mobility_of(rig)


def _plan(rig: Rig, path: Path | None, poses: int | None) -> Plan | None:
    """The plan to execute: the rig's or a file's, with another number of poses where asked for."""
    plan = rig.plan if path is None else load_plan(path)
    return plan if plan is None or poses is None else plan.model_copy(update={"poses": poses})


class View:
    """The session on the terminal: phase and hint, a bar of stops, rates and losses of every channel.

    On anything but a terminal it prints a line whenever a tenth of the stops is done.
    """

    def __init__(self, arming: Arming) -> None:
        self._arming = arming
        self._renewals = Renewals()
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=out,
        )
        self._task = self._bar.add_task("stops", total=None)
        self._live = Live(console=out, refresh_per_second=8, transient=True)
        self._tenth = -1

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        if self._live.is_started:
            self._live.stop()

    def ask(self, joints: tuple[str, ...]) -> bool:
        """Ask the operator to arm; without a terminal nobody can agree."""
        if not out.is_terminal:
            err.print(
                f"loopcal: {', '.join(joints)} are real drives; arm them with --arm", markup=False
            )
            return False
        out.print(
            f"The session will move [bold]{', '.join(joints)}[/bold]. Keep clear of the mechanism."
        )
        return typer.confirm("Arm the drives?", default=False)

    def show(self, progress: Progress) -> None:
        """Draw a snapshot, and renew the arming where somebody asked for it."""
        if progress.armed_s is not None and self._renewals.came():
            self._arming.renew()
        if not out.is_terminal:
            self._print(progress)
            return
        if not self._live.is_started:
            self._live.start()
        self._bar.update(self._task, total=progress.stops, completed=progress.dwells)
        table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
        for column in ("channel", "rate", "received", "lost"):
            table.add_column(column, justify="left" if column == "channel" else "right")
        for channel in progress.channels:
            lost = Text(str(channel.lost), style="red" if channel.lost else "")
            table.add_row(channel.name, f"{channel.rate_hz:.0f} Hz", str(channel.received), lost)
        lines: list[RenderableType] = [
            Text(f"{progress.phase}: {progress.hint}", style="bold"),
            *_armed(progress),
            self._bar,
            table,
        ]
        if progress.latest_fault is not None:
            fault = progress.latest_fault
            lines.append(
                Text(
                    f"{progress.faults} faults, latest at {fault.source}: {fault.text}",
                    style="yellow",
                )
            )
        self._live.update(Group(*lines))

    def _print(self, progress: Progress) -> None:
        tenth = 10 * progress.dwells // max(progress.stops, 1)
        if tenth != self._tenth:
            self._tenth = tenth
            lost = sum(channel.lost for channel in progress.channels)
            out.print(
                f"{progress.dwells} of {progress.stops} stops after {progress.elapsed_s:.0f} s, {lost} readings lost",
                markup=False,
            )
            out.file.flush()


def _armed(progress: Progress) -> list[Text]:
    """The state, and how long the arming still lasts."""
    if progress.armed_s is None:
        return []
    minutes, seconds = divmod(int(progress.armed_s), 60)
    style = "red" if progress.armed_s < SHORT_S else ""
    text = f"{progress.state.name.lower()}; armed for another {minutes}:{seconds:02d}, Enter renews"
    return [Text(text, style=style)]


class Renewals:
    """Lines on standard input. Never waits for one; at the end of the input there are no more."""

    def __init__(self) -> None:
        try:
            self._descriptor: int | None = sys.stdin.fileno()
        except (AttributeError, OSError, ValueError):
            self._descriptor = None

    def came(self) -> bool:
        """Whether a line has come since the last look."""
        if self._descriptor is None or not self._ours():
            return False
        try:
            if not select.select([self._descriptor], [], [], 0)[0]:
                return False
            data = os.read(self._descriptor, 4096)
        except OSError:
            data = b""
        if not data:
            self._descriptor = None
        return b"\n" in data

    def _ours(self) -> bool:
        """Whether the terminal listens to this process: reading from the background would stop it."""
        descriptor = self._descriptor
        assert descriptor is not None
        return not os.isatty(descriptor) or os.tcgetpgrp(descriptor) == os.getpgrp()


def _parts(summary: CaptureSummary) -> str:
    return f" and {summary.parts - 1} more parts" if summary.parts > 1 else ""


def show_summary(summary: CaptureSummary) -> None:
    """Print what was recorded and what was lost."""
    style = {Ending.COMPLETE: "green", Ending.STOPPED: "yellow", Ending.FAILED: "red"}[
        summary.ending
    ]
    why = f": {summary.why}" if summary.why else ""
    out.print(Text(f"session {summary.ending}{why}", style=style), soft_wrap=True)
    out.print(
        f"{summary.path}{_parts(summary)}: {len(summary.dwells)} dwells at {summary.poses} poses in {summary.duration_s:.1f} s",
        markup=False,
        soft_wrap=True,
    )
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    columns = (
        "channel",
        "expected",
        "received",
        "lost by device",
        "by host",
        "in gaps",
        "unaccounted",
    )
    for column in columns:
        table.add_column(column, justify="left" if column == "channel" else "right", no_wrap=True)
    for name, entry in summary.ledger.items():
        losses = (
            entry.dropped_by_device,
            entry.dropped_by_host,
            entry.lost_in_gaps,
            entry.unaccounted,
        )
        cells = [Text(str(loss), style="red" if loss else "") for loss in losses]
        table.add_row(name, str(entry.expected), str(entry.received), *cells)
    out.print(table)
    _show_states(summary)
    show_timing(summary.timing)
    troubles = episodes(summary.faults)
    for trouble in troubles[:10]:
        out.print(
            Text(
                f"fault at {trouble.source} ({_lasting(trouble)}): {trouble.text}", style="yellow"
            ),
            soft_wrap=True,
        )
    if len(troubles) > 10:
        out.print(f"and {len(troubles) - 10} more faults, all in the recording", markup=False)


def _lasting(trouble: Episode) -> str:
    """The kind of a fault, and how long it lasted."""
    if trouble.end_ns is None:
        return f"{trouble.kind}, to the end"
    seconds = (trouble.end_ns - trouble.begin_ns) / 1e9
    return f"{trouble.kind}, {seconds:.1f} s" if seconds else trouble.kind


def _show_states(summary: CaptureSummary) -> None:
    """Print how often the session went from one state to another, and why it last did."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in ("state", "to", "times", "last because"):
        table.add_column(column, justify="right" if column == "times" else "left")
    times = Counter((change.before, change.after) for change in summary.states)
    last = {(change.before, change.after): change.cause for change in summary.states}
    for (before, after), count in times.items():
        style = "bold" if after is SessionState.SAFE else ""
        cells = (before.name.lower(), after.name.lower(), str(count), last[before, after])
        table.add_row(*(Text(cell, style=style) for cell in cells))
    out.print(table)
