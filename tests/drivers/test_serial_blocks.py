"""Ports that are read in blocks: ptys, sockets and pyserial's URLs alike."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import pytest

from drivers.serial_blocks import SerialBlocks, open_blocks
from sim_devices.virtual_time import time_is
from tests.drivers.patience import PATIENCE_S

Opened = tuple[SerialBlocks, Callable[[bytes], None]]


@contextmanager
def pty_port(line) -> Iterator[Opened]:
    port = open_blocks(line.path, baudrate=115_200)
    yield port, line.write
    port.close()


@contextmanager
def socket_port(line) -> Iterator[Opened]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_blocks(f"socket://127.0.0.1:{server.getsockname()[1]}", baudrate=115_200)
        peer, _ = server.accept()
        with peer:
            yield port, peer.sendall
        port.close()


@contextmanager
def loop_port(line) -> Iterator[Opened]:
    port = open_blocks("loop://", baudrate=921_600)
    yield port, port.write
    port.close()


@pytest.mark.parametrize("opened", [pty_port, socket_port, loop_port])
def test_what_has_come_is_read_at_once(line, opened):
    with opened(line) as (port, send):
        assert port.read(0.0) == b""
        before = time.monotonic()
        assert port.read(0.02) == b""
        assert time.monotonic() - before >= 0.015
        send(b"x" * 500)
        came = b""
        while len(came) < 500:
            block = port.read(PATIENCE_S)
            assert block
            came += block
        assert came == b"x" * 500


def test_a_port_that_takes_nothing_is_given_up(line, clock):
    port = open_blocks(line.path, baudrate=115_200)
    # Nobody reads at the far end; time passes in each wait for it.
    with time_is(clock), patch.object(select, "select", lambda *of: clock.advance(of[3])):
        with pytest.raises(OSError, match="takes nothing"):
            port.write(b"x" * 1_000_000)
        assert 0.2 < clock.time_s < 0.3
    port.close()


def test_a_port_that_takes_its_time_gets_all(line, clock):
    port, big, came = open_blocks(line.path, baudrate=115_200), bytes(range(256)) * 100, b""

    def read_at_the_far_end(*_of) -> None:
        nonlocal came
        clock.advance(0.001)
        came += os.read(line.master, 4096)

    with time_is(clock), patch.object(select, "select", read_at_the_far_end):
        port.write(big)
    while len(came) < len(big):
        came += line.read()
    assert came == big
    port.close()


def test_a_write_that_the_host_slept_in_is_done(line, clock, monkeypatch):
    port, write = open_blocks(line.path, baudrate=115_200), os.write

    def sleep_behind(descriptor: int, data: bytes) -> int:
        written = write(descriptor, data)
        clock.advance(3.0)
        return written

    with time_is(clock), patch.object(os, "write", sleep_behind):
        port.write(b"t1230\r")
    assert line.read_until(b"\r") == b"t1230\r"
    port.close()


def test_a_pty_that_is_gone_says_so(line):
    port = open_blocks(line.path, baudrate=115_200)
    line.unplug()
    with pytest.raises(OSError, match=r"Input/output error|gives nothing"):
        port.read(PATIENCE_S)
    port.close()


def test_a_url_without_a_port_number():
    with pytest.raises(ValueError, match="expected socket://HOST:PORT"):
        open_blocks("socket://localhost", baudrate=9600)
