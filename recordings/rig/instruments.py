"""What reads the mechanism: ports (a bus or a line), devices on them, channels they deliver.

Options that only one driver understands stay a plain table here; the driver checks them
(`drivers.registry`), so that drivers can be added without touching the rig schema.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from recordings.rig.quantity import COORDINATE, GAIN, LENGTH, Described, Quantity, fail

Count = Annotated[int, Field(ge=-(2**53), le=2**53)]
"""A raw count: an integer that a double holds exactly."""

LARGEST_PORT_NUMBER = 65_535


class CanPort(Described):
    """A CAN bus, through any interface that python-can knows (slcan, socketcan, virtual, ...).

    ``listen_only`` forbids every transmission; ``adapter_time`` takes the adapter's time stamps
    as device time of the readings whose own device has none.
    """

    kind: Literal["can"]
    name: str
    interface: str
    channel: str
    bitrate: int = 1_000_000
    listen_only: bool = False
    adapter_time: bool = False
    options: dict[str, Any] = Field(default_factory=dict)


class SerialPort(Described):
    """A serial line, by path or by any URL that pyserial knows."""

    kind: Literal["serial"]
    name: str
    path: str
    baudrate: int = 115_200
    parity: Literal["N", "E", "O"] = "N"
    stopbits: int = 1


class TcpPort(Described):
    """A TCP connection to a device or gateway, which is the server: ``HOST:PORT``."""

    kind: Literal["tcp"]
    name: str
    address: str

    @property
    def host(self) -> str:
        """Name or address of the server."""
        return self.address.rpartition(":")[0].strip("[]")

    @property
    def number(self) -> int:
        """Port number of the server, 0 to 65,535."""
        return int(self.address.rpartition(":")[2])

    @model_validator(mode="after")
    def _address_is_whole(self) -> TcpPort:
        host, _, number = self.address.rpartition(":")
        if not host or not number.isdecimal() or int(number) > LARGEST_PORT_NUMBER:
            raise fail(f"'address' is '{self.address}', expected HOST:PORT, as in \"10.0.0.5:502\"")
        return self


class Device(Described):
    """One device: the driver that speaks its protocol, the port it is on, that driver's options.

    ``file`` names a file that describes the device to its driver, such as a DBC. Its text is
    the rig's entry of that name in ``files`` (`recordings.rig.files`).
    """

    name: str
    driver: str
    port: str
    joint: str | None = None
    file: str | None = None
    options: dict[str, Any] = Field(default_factory=dict)


class Channel(Described):
    """One sensor: raw counts, and what they mean.

    value = gain * (counts - zero_count) + offset, in rad or m. ``modulus_counts`` says that
    the counter wraps; counts are then taken in [zero - modulus/2, zero + modulus/2).
    ``noise`` is the standard deviation expected of one sample, in counts; a solve uses the
    noise that it measures. ``turn`` is the travel of one revolution of a length sensor's shaft
    (a draw-wire drum, a spindle); joints that turn need none.
    """

    quantities: ClassVar[dict[str, tuple[str, ...]]] = {
        "gain": GAIN,
        "offset": COORDINATE,
        "noise": ("counts",),
        "turn": LENGTH,
    }

    name: str
    senses: str
    device: str | None = None
    signal: str | int | None = None
    gain: Quantity
    offset: Quantity = Quantity()
    zero_count: Count = 0
    count_range: tuple[Count, Count] | None = None
    modulus_counts: Count | None = None
    noise: float = 0.0
    turn: float | None = None

    @model_validator(mode="after")
    def _counts_make_sense(self) -> Channel:
        if self.count_range is not None and not self.count_range[0] < self.count_range[1]:
            found = list(self.count_range)
            raise fail(f"'count_range' is {found}, expected [lowest, highest]")
        if self.modulus_counts is not None and self.modulus_counts <= 1:
            raise fail(f"'modulus_counts' is {self.modulus_counts}, expected above 1")
        if self.turn is not None and self.turn <= 0:
            raise fail(f"'turn' of the channel '{self.name}' is {self.turn} m, expected above 0")
        if self.noise < 0:
            raise fail(f"'noise_counts' is {self.noise}, expected 0 or above")
        return self
