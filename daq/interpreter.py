"""What a session asks of the interpreter: that none of its threads waits long for another.

A full collection of garbage looks at every object of the program, for a tenth of a second, and all
threads wait: long enough for the buffer of an adapter on a full bus to run over. What there is when a
session begins outlives it, and need not be looked at meanwhile.

A thread that comes back from its port or its disk waits for the interpreter as long as each busy one may
keep it. With Python's 5 ms, four full buses starve the thread of the file, which comes and goes several
times a chunk, and converters beside them are polled half as often as they should be.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SWITCH_S = 0.001
"""Longest time that a busy thread keeps the interpreter while another waits for it [s]."""


@contextmanager
def set_for_a_session() -> Iterator[None]:
    """Collect now and leave what is left out of all collections; let threads take turns quickly."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before_s)
