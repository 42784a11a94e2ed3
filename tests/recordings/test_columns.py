"""Finding the records of a block without walking it finds what walking it finds."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recordings.columns import messages
from recordings.offsets import record_offsets


def record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + len(content).to_bytes(8, "little") + content


def walked(data: bytes) -> tuple[list[int], int]:
    offsets, at = [], 0
    while at + 9 <= len(data):
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if end > len(data):
            break
        offsets.append(at)
        at = end
    return offsets, at


# Contents that hold records themselves are what could mislead.
CONTENT = st.recursive(
    st.binary(max_size=40),
    lambda inner: st.lists(
        st.builds(record, st.sampled_from([3, 4, 5]), inner), min_size=1, max_size=3
    ).map(b"".join),
    max_leaves=8,
)
RECORDS = st.lists(
    st.builds(record, st.sampled_from([3, 4, 5, 5, 5, 9, 200]), CONTENT), max_size=12
)


@given(RECORDS.map(b"".join), st.integers(0, 60))
def test_offsets_are_those_of_a_walk(data: bytes, cut: int) -> None:
    data = data[: len(data) - cut] if cut < len(data) else data
    offsets, end = record_offsets(data)
    assert (offsets.tolist(), end) == walked(data)


@given(st.binary(max_size=200))
def test_any_bytes_are_walked(data: bytes) -> None:
    offsets, end = record_offsets(data)
    assert (offsets.tolist(), end) == walked(data)
    found = messages(data, offsets)
    assert np.all(found.start + found.size <= len(data))


def test_messages_are_told_from_other_records() -> None:
    head = b"\x07\x00" + bytes(4) + (99).to_bytes(8, "little") + bytes(8)
    data = record(4, b"channel") + record(5, head + b"payload") + record(5, b"too short")
    found = messages(data, record_offsets(data)[0])
    assert found.channel_id.tolist() == [7]
    assert found.time_ns().tolist() == [99]
    assert found.payload(0) == b"payload"
