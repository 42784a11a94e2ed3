"""When the faults of a virtual bench begin and end. Thread-safe in front, one thread behind.

Anyone may inject; the thread that runs the bench lets time pass here, and what is due is done
at its next turn. Which faults are active decides what is disturbed: two that overlap leave
nothing behind when both are over.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable, Mapping
from typing import Protocol

from recordings.rig import Rig
from sim_devices.faults.script import Order, parse, parse_line

Active = Mapping[tuple[str, str], Order]
"""The faults that are active now, by verb and target."""


class Wired(Protocol):
    """What faults are done to."""

    def happen(self, order: Order, time_s: float) -> None:
        """Do what happens once, at the beginning of a fault or at its end."""

    def disturb(self, active: Active) -> None:
        """Disturb what the active faults disturb, and nothing else."""


class Injector:
    """The faults of one bench.

    Args:
        rig: the rig whose names the lines use.
        script: fault script to execute; its times are those of the bench.
        on_event: told of each fault that begins or ends, with the time [s]; in the bench's thread.

    Raises:
        ScriptError: the script cannot be understood.
    """

    def __init__(
        self,
        rig: Rig,
        script: str = "",
        on_event: Callable[[float, str], None] | None = None,
    ) -> None:
        self._rig = rig
        self._on_event = on_event
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._due: list[tuple[float, int, Order]] = []
        self._new: list[Order] = []
        self._active: dict[tuple[str, str], Order] = {}
        self._ends: dict[tuple[str, str], int] = {}
        self._wired: Wired | None = None
        for order in parse(script, rig):
            self._schedule(order.at_s or 0.0, order)

    def inject(self, line: str) -> None:
        """Execute a line of a script, now or at its time; from any thread. Raises ScriptError."""
        order = parse_line(line, self._rig)
        if order is not None:
            with self._lock:
                self._new.append(order)

    @property
    def active(self) -> tuple[str, ...]:
        """The faults that are active, as ``VERB TARGET``; may be read from any thread."""
        with self._lock:
            return tuple(f"{verb} {target}" for verb, target in self._active)

    def bind(self, wired: Wired) -> None:
        """Do it to this bench from now on."""
        self._wired = wired

    def advance(self, time_s: float) -> None:
        """Let time pass; called by the thread that runs the bench."""
        if not self._new and not (self._due and self._due[0][0] <= time_s):
            return
        with self._lock:
            for order in self._new:
                self._schedule(time_s if order.at_s is None else order.at_s, order)
            self._new.clear()
            done = []
            while self._due and self._due[0][0] <= time_s:
                at_s, number, order = heapq.heappop(self._due)
                if self._execute(at_s, number, order):
                    done.append(order)
        if self._wired is not None:
            for order in done:
                self._wired.happen(order, time_s)
            self._wired.disturb(self._active)
        if self._on_event is not None:
            for order in done:
                self._on_event(time_s, order.text)

    def _schedule(self, at_s: float, order: Order) -> int:
        number = next(self._numbers)
        heapq.heappush(self._due, (at_s, number, order))
        return number

    def _execute(self, at_s: float, number: int, order: Order) -> bool:
        """Note what begins or ends; whether there is anything to do."""
        key = (order.fault.verb, order.target)
        if order.ends:
            # The end of a duration counts only for the fault that it belongs to.
            planned = self._ends.get(key)
            if key not in self._active or (order.for_s is not None and planned != number):
                return False
            del self._active[key]
            self._ends.pop(key, None)
        elif order.fault.lasts:
            self._active[key] = order
            self._ends.pop(key, None)
            if order.for_s is not None:
                text = f"end {order.fault.verb} {order.target}"
                end = Order(None, order.fault, order.target, True, for_s=order.for_s, text=text)
                self._ends[key] = self._schedule(at_s + order.for_s, end)
        return True
