"""A virtual port on TCP can be reached from this computer, and from no other."""

from __future__ import annotations

import pytest

from sim_devices.errors import PortUnavailable
from sim_devices.tcp_port import TcpServerPort


class Nobody:
    def receive(self, data: bytes, time_s: float) -> bytes:
        return b""

    def tick(self, time_s: float) -> bytes:
        return b""

    def hang_up(self) -> None:
        pass

    def overrun(self) -> None:
        pass


@pytest.mark.parametrize("address", ["127.0.0.1:0", "localhost:0", "socket://127.0.0.1:0"])
def test_it_listens_on_this_computer(address: str) -> None:
    port = TcpServerPort("line", address, Nobody())
    port.open()
    try:
        assert port.fileno() is not None
        assert not port.address.endswith(":0")
    finally:
        port.close()


@pytest.mark.parametrize("address", ["0.0.0.0:0", "192.0.2.1:502"])
def test_it_does_not_listen_where_others_can_reach_it(address: str) -> None:
    port = TcpServerPort("line", address, Nobody())
    with pytest.raises(PortUnavailable, match=r"others can reach.*127\.0\.0\.1:"):
        port.open()
    assert port.fileno() is None


@pytest.mark.parametrize("address", ["nowhere", "127.0.0.1:port", "127.0.0.1:99999"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(PortUnavailable, match="line"):
        TcpServerPort("line", address, Nobody()).open()
