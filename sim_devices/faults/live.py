"""Fault lines that somebody types, or another program sends, while a bench runs.

Looked at now and then by the thread that runs the bench, never waited for. A terminal is read
only while the program is in its foreground: a bench in the background must not be stopped by
the system for reading what is typed for another program.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable

from sim_devices.faults.injector import Injector
from sim_devices.faults.script import ScriptError

BLOCK = 4096


class LiveLines:
    """Lines from the descriptor of a pipe or terminal, injected as they come.

    Args:
        descriptor: where to read; not closed here.
        faults: what to inject them into.
        on_error: told of each line that cannot be understood, in words.
    """

    def __init__(self, descriptor: int, faults: Injector, on_error: Callable[[str], None]) -> None:
        self._descriptor = descriptor
        self._faults = faults
        self._on_error = on_error
        self._rest = b""
        self._ended = False

    def poll(self) -> None:
        """Inject the lines that have come; harmless after the end of the input."""
        while not self._ended and self._readable():
            data = os.read(self._descriptor, BLOCK)
            self._ended = not data
            *lines, self._rest = (self._rest + (data or b"\n")).split(b"\n")
            for line in lines:
                self._inject(line.decode("utf-8", "replace"))

    def _readable(self) -> bool:
        if os.isatty(self._descriptor) and os.tcgetpgrp(self._descriptor) != os.getpgrp():
            return False
        return bool(select.select([self._descriptor], [], [], 0.0)[0])

    def _inject(self, line: str) -> None:
        try:
            self._faults.inject(line)
        except ScriptError as error:
            self._on_error(str(error))
