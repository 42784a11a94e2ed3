"""Ports that are read in blocks: ptys, sockets and pyserial's URLs alike."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from drivers.serial_blocks import SerialBlocks, open_blocks
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


def test_a_pty_that_is_gone_says_so(line):
    port = open_blocks(line.path, baudrate=115_200)
    line.unplug()
    with pytest.raises(OSError, match=r"Input/output error|gives nothing"):
        port.read(PATIENCE_S)
    port.close()


def test_a_url_without_a_port_number():
    with pytest.raises(ValueError, match="expected socket://HOST:PORT"):
        open_blocks("socket://localhost", baudrate=9600)
