"""Blocks of a file put together, as many as are worth the work that an array takes.

Owns where the records of several blocks begin, and that a block which ends inside a record
does not cost the blocks behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.items import Block, Damage
from recordings.offsets import record_offsets

WINDOW_BYTES = 1024 * 1024
"""Uncompressed bytes that are looked at together."""


@dataclass(frozen=True, slots=True)
class Records:
    """The records of some blocks.

    Attributes:
        offset: where the first block is in the file.
        data: the blocks, one behind the other.
        offsets: (n,) where the records begin in ``data``.
        damage: blocks that end inside a record.
    """

    offset: int
    data: bytes
    offsets: NDArray[np.int64]
    damage: tuple[Damage, ...]


class Window:
    """Takes blocks in file order."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._bytes = 0

    def add(self, block: Block) -> Records | None:
        """Take a block; the records of all that were taken, once they are enough."""
        self._blocks.append(block)
        self._bytes += len(block.data)
        return self.rest() if self._bytes >= WINDOW_BYTES else None

    def rest(self) -> Records | None:
        """The records of the blocks that still wait, or None where none does."""
        if not self._blocks:
            return None
        blocks, self._blocks, self._bytes = self._blocks, [], 0
        data = b"".join(block.data for block in blocks)
        offsets, damage = _offsets(blocks, data)
        return Records(blocks[0].offset, data, offsets, damage)


def _offsets(blocks: list[Block], data: bytes) -> tuple[NDArray[np.int64], tuple[Damage, ...]]:
    ends = np.cumsum([len(block.data) for block in blocks])
    offsets, end = record_offsets(data)
    bounds = np.append(offsets, end)
    if end == len(data) and np.all(bounds[np.searchsorted(bounds, ends)] == ends):
        return offsets, ()
    found, damage = [], []
    for block, block_end in zip(blocks, ends.tolist(), strict=True):
        own, end = record_offsets(block.data)
        if end < len(block.data):
            damage.append(Damage(block.offset, "a block that ends inside a record"))
        found.append(own + (block_end - len(block.data)))
    return np.concatenate(found), tuple(damage)
