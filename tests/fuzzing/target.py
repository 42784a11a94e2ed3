"""What is fuzzed, as one kind of thing: valid inputs to start from, and what must hold of any other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """A reader of something that comes from outside.

    Attributes:
        name: for messages and folders.
        seeds: makes valid inputs.
        check: takes any input and returns; whatever it raises is a finding. It allows for the
            errors that the reader documents, and for no others.
        tokens: pieces that mean something in the format.
        text: whether the input is text, which is then changed by lines and numbers too.
        check_flips: takes a valid input and the same with one to three bits turned; for formats
            whose checksum must notice that. Raises where the change was taken for the truth.
    """

    name: str
    seeds: Callable[[], Sequence[bytes]]
    check: Callable[[bytes], None]
    tokens: Sequence[bytes] = ()
    text: bool = False
    check_flips: Callable[[bytes, bytes], None] | None = None
