"""What a bench needs of a port: to open it, wait for it, serve it, close it."""

from __future__ import annotations

from typing import Protocol


class Port(Protocol):
    """One open end of a bus or line, with the virtual devices behind it.

    Attributes:
        name: port name of the rig.
        address: where a host finds it (a path, or a bus of some CAN interface).
    """

    name: str

    @property
    def address(self) -> str: ...

    def open(self) -> None:
        """Appear at the address; raises PortTaken or PortUnavailable."""

    def close(self) -> None:
        """Disappear again; closing twice is allowed."""

    def fileno(self) -> int | None:
        """Descriptor that becomes readable when the host sends, or None.

        None while no host has the port open, and where there is no descriptor (`polled`).
        """

    @property
    def polled(self) -> bool:
        """Whether the port must be served regularly, because nothing tells when data comes."""

    def serve(self, time_s: float) -> None:
        """Take what the host has sent and answer it."""

    def tick(self, time_s: float) -> None:
        """Let time pass for the devices, and send what became due."""
