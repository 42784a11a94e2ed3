"""The pseudo-terminal port: its link, its host coming and going, a host that does not read."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sim_devices.errors import PortTaken, PortUnavailable
from sim_devices.pty_port import MOST_WAITING, PtyPort
from tests.sim_devices.wires.echo import EchoLine

PATIENCE_S = 60.0


@pytest.fixture
def port(tmp_path: Path, line: EchoLine) -> Iterator[PtyPort]:
    made = PtyPort("wire", str(tmp_path / "wire"), line)
    made.open()
    yield made
    made.close()


@pytest.fixture
def host(port: PtyPort) -> Iterator[Callable[[], int]]:
    opened: list[int] = []

    def open_host() -> int:
        opened.append(os.open(port.address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        return opened[-1]

    yield open_host
    for descriptor in opened:
        # A test may have closed it itself, to hang up.
        if Path(f"/proc/self/fd/{descriptor}").exists():
            os.close(descriptor)


def arrived(descriptor: int) -> bytes:
    assert select.select([descriptor], [], [], PATIENCE_S)[0], "nothing came through"
    return os.read(descriptor, 65_536)


def test_bytes_pass_unchanged_both_ways(port: PtyPort, host) -> None:
    descriptor = host()
    port.tick(0.0)
    every = bytes(range(256))
    os.write(descriptor, every)
    assert select.select([port.fileno()], [], [], PATIENCE_S)[0]
    port.serve(0.0)
    assert arrived(descriptor) == every


def test_no_descriptor_without_a_host(port: PtyPort, line: EchoLine, host) -> None:
    port.tick(0.0)
    assert port.fileno() is None
    descriptor = host()
    port.tick(0.1)
    assert port.fileno() is not None
    os.close(descriptor)
    port.serve(0.2)
    assert (port.fileno(), line.hang_ups) == (None, 1)


def test_next_host_does_not_get_what_the_last_left_unread(
    port: PtyPort, line: EchoLine, host
) -> None:
    first = host()
    port.tick(0.0)
    line.due = b"stale"
    port.tick(0.1)
    assert select.select([first], [], [], PATIENCE_S)[0]
    os.close(first)
    port.serve(0.2)
    line.due = b"to nobody"
    port.tick(0.3)
    second = host()
    port.tick(0.4)
    line.due = b"fresh"
    port.tick(0.5)
    assert arrived(second) == b"fresh"


def test_command_of_a_host_that_has_gone_already_is_obeyed(
    port: PtyPort, host, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[bytes] = []
    monkeypatch.setattr(port._line, "receive", lambda data, time_s: heard.append(data) or b"")
    descriptor = host()
    os.write(descriptor, b"stop\r")
    os.close(descriptor)
    port.tick(0.0)
    assert port.fileno() is not None
    port.serve(0.0)
    port.serve(0.0)
    assert heard == [b"stop\r"]
    assert port.fileno() is None


def test_host_that_does_not_read_loses_whole_messages(port: PtyPort, line: EchoLine, host) -> None:
    descriptor = host()
    port.tick(0.0)
    message = b"0123456789abcde\r"
    sent = 3 * (MOST_WAITING + 4096) // len(message)
    for n in range(sent):
        line.due = message
        port.tick(0.001 * n)
    assert port.lost_bytes == line.overruns * len(message) > 0
    got = b""
    while len(got) + port.lost_bytes < sent * len(message):
        port.tick(1000.0)
        got += arrived(descriptor)
    assert got == message * (len(got) // len(message))


def test_link_is_made_and_removed(tmp_path: Path, line: EchoLine) -> None:
    path = tmp_path / "wire"
    port = PtyPort("wire", str(path), line)
    port.open()
    assert path.is_symlink()
    assert path.is_char_device()
    port.close()
    port.close()
    assert not path.is_symlink()


def test_dangling_link_is_replaced(tmp_path: Path, line: EchoLine) -> None:
    path = tmp_path / "wire"
    path.symlink_to("/dev/pts/no-such-terminal")
    port = PtyPort("wire", str(path), line)
    port.open()
    assert path.is_char_device()
    port.close()


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_taken_path_is_refused_and_left_alone(tmp_path: Path, line: EchoLine, kind: str) -> None:
    path = tmp_path / "wire"
    if kind == "file":
        path.write_text("precious")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(tmp_path)
    before = os.lstat(path)
    with pytest.raises(PortTaken, match=r"wire.*is taken"):
        PtyPort("wire", str(path), line).open()
    assert os.lstat(path) == before


def test_link_that_became_anothers_is_left_alone(tmp_path: Path, port: PtyPort) -> None:
    path = Path(port.address)
    path.unlink()
    path.symlink_to(tmp_path)
    port.close()
    assert path.is_symlink()


def test_folder_that_does_not_exist(tmp_path: Path, line: EchoLine) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(PortUnavailable, match="No such file or directory"):
        PtyPort("wire", str(tmp_path / "no" / "wire"), line).open()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
