"""Chunks decompress whatever their size and compression, and exactly to it."""

from __future__ import annotations

import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard

from recordings.records import Chunk, Malformed, decompress

MIB = 1 << 20
DATA = np.random.default_rng(1).bytes(2 * MIB) + bytes(2 * MIB)
COMPRESSORS = {
    "": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
    "zstd of no stated size": zstandard.ZstdCompressor(write_content_size=False).compress,
}


@pytest.mark.parametrize("name", COMPRESSORS)
@pytest.mark.parametrize("size", [0, 1, MIB - 1, MIB, MIB + 1, len(DATA)])
def test_chunks_come_back(name: str, size: int) -> None:
    data = DATA[:size]
    packed = COMPRESSORS[name](data)
    chunk = Chunk(0, 0, size, zlib.crc32(data), name.partition(" ")[0], packed)
    assert decompress(chunk) == data


@pytest.mark.parametrize("name", COMPRESSORS)
@pytest.mark.parametrize("stated", [99, 101])
def test_another_size_than_stated_is_malformed(name: str, stated: int) -> None:
    packed = COMPRESSORS[name](bytes(100))
    with pytest.raises(Malformed, match=rf"a chunk of \d+ bytes that should have {stated}"):
        decompress(Chunk(0, 0, stated, 0, name.partition(" ")[0], packed))


def test_a_wrong_crc_is_malformed() -> None:
    with pytest.raises(Malformed, match="wrong CRC"):
        decompress(Chunk(0, 0, 3, 1, "", b"abc"))
