"""Frames taken many at once are those taken one by one: same order, same data, same garble counted."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import slcan
from drivers.can_bus import CanBus
from drivers.errors import LinkBroken
from recordings.rig import CanPort


class Port:
    """Gives blocks, then nothing; then it is gone."""

    def __init__(self, blocks: list[bytes], *, gone: bool = False) -> None:
        self.blocks = deque(blocks)
        self.gone = gone

    def read(self, timeout_s: float | None) -> bytes:
        if not self.blocks and self.gone:
            raise OSError("unplugged")
        return self.blocks.popleft() if self.blocks else b""

    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class Clock:
    def now_ns(self) -> int:
        return 5


def bus_on(port: Port, monkeypatch: pytest.MonkeyPatch) -> CanBus:
    monkeypatch.setattr(slcan, "open_blocks", lambda path, **options: port)
    described = CanPort(
        kind="can", name="bus", interface="slcan", channel="socket://fake:1", bitrate=1_000_000
    )
    bus = CanBus(described, Clock())
    bus.open()
    return bus


LINE = st.sampled_from(
    [
        *(b"t%03X8%016X\r" % (0x181 + n, n) for n in range(3)),
        b"t7FF0\r",
        b"t8000\r",  # beyond 11 bits
        b"t1812AAB\r",  # a digit short
        b"t1812AA_B\r",
        b"t 812AABB\r",
        b"T1FFFFFFF2AABB\r",
        b"t1812AABB1234\r",  # with a time stamp
        b"r1812\r",
        b"z\r",
        b"\r",
        b"nonsense\r",
    ]
)


@given(st.lists(LINE, max_size=30), st.integers(1, 40), st.integers(1, 9))
@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, derandomize=True
)
def test_at_once_is_as_one_by_one(
    monkeypatch: pytest.MonkeyPatch, lines: list[bytes], size: int, most: int
) -> None:
    data = b"".join(lines)
    blocks = [data[at : at + size] for at in range(0, len(data), size)]
    single, many = (bus_on(Port(blocks), monkeypatch) for _ in range(2))
    turns = range(len(blocks) + len(lines) + 1)
    one_by_one = [frame for _ in turns if (frame := single.receive(0.0)) is not None]
    at_once = []
    for _ in turns:
        found = many.receive_all(0.0, most)
        assert len(found) <= most
        at_once += found
    assert at_once == one_by_one
    assert many.malformed == single.malformed


def test_frames_that_came_before_an_unplug_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = bus_on(Port([b"t1812AABB\rt1812CCDD\r"], gone=True), monkeypatch)
    assert [frame.data.hex() for frame in bus.receive_all(0.0, 100)] == ["aabb", "ccdd"]
    with pytest.raises(LinkBroken, match="unplugged"):
        bus.receive_all(0.0, 100)
