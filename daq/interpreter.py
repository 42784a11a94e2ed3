"""What a session asks of the interpreter: that none of its threads waits long for a collection.

A full collection of garbage looks at every object of the program, for a tenth of a second, and all
threads wait: long enough for the buffer of an adapter on a full bus to run over. What there is when a
session begins outlives it, and need not be looked at meanwhile.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def set_for_a_session() -> Iterator[None]:
    """Collect now, and leave what is left out of all collections until the end."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
