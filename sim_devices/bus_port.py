"""A CAN bus of any interface that python-can knows, with virtual nodes on it.

For rigs whose CAN port is not slcan: the nodes join ``socketcan``, ``virtual`` or another
interface as one more participant. ``virtual`` reaches hosts of the same process only.
"""

from __future__ import annotations

import random
from collections.abc import Sequence

import can

from recordings.rig import CanPort
from sim_devices.can_bus import CanBus, Frame
from sim_devices.errors import PortUnavailable

BUS_OFF, BUS_ERROR = 0x40, 0x80
"""Classes of error frames, as in the identifier of an error frame of SocketCAN."""

MOST_FRAMES = 1024
"""Frames taken in one turn, so that a flooded bus cannot keep the bench from its other ports."""


class BusPort:
    """A participant in the bus of ``port``, for the nodes of ``bus``.

    Attributes:
        name: port name of the rig.
        address: interface and channel.
        refused_frames: frames that the interface did not take.
        bus_off: whether its controller is driven off the bus: it says so, and nothing passes.
        corrupt: probability that a frame for the host becomes an error frame.
    """

    def __init__(self, port: CanPort, bus: CanBus) -> None:
        self.name = port.name
        self.address = f"{port.interface}:{port.channel}"
        self.refused_frames = 0
        self.bus_off = False
        self.corrupt = 0.0
        self._random = random.Random(port.name)
        self._port = port
        self._nodes = bus
        self._bus: can.BusABC | None = None
        self._descriptor: int | None = None

    def open(self) -> None:
        """Join the bus; raises PortUnavailable."""
        port = self._port
        try:
            self._bus = can.Bus(
                interface=port.interface,
                channel=port.channel,
                bitrate=port.bitrate,
                **port.options,
            )
        except (can.CanError, OSError, ImportError, ValueError, TypeError) as error:
            raise PortUnavailable(
                f"cannot join the CAN bus {self.address} for port '{self.name}': {error}"
            ) from error
        self._descriptor = _descriptor(self._bus)

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def fileno(self) -> int | None:
        """The interface's descriptor, None where it has none."""
        return self._descriptor if self._bus is not None else None

    @property
    def polled(self) -> bool:
        """Whether the interface has no descriptor."""
        return self._descriptor is None

    def serve(self, time_s: float) -> None:
        """Take the frames that have come and answer them."""
        if self._bus is None:
            return
        for _ in range(MOST_FRAMES):
            message = self._bus.recv(0)
            if message is None:
                return
            if message.is_error_frame or message.is_fd or self.bus_off:
                continue
            remote = message.dlc if message.is_remote_frame else None
            data = b"" if message.is_remote_frame else bytes(message.data)
            frame = Frame(message.arbitration_id, data, message.is_extended_id, remote)
            self._send(self._nodes.receive(frame, time_s))

    def tick(self, time_s: float) -> None:
        """Let time pass for the nodes."""
        frames = self._nodes.tick(time_s)
        if self.bus_off:
            self._put(_error_frame(BUS_OFF))
        self._send(frames)

    def _send(self, frames: Sequence[Frame]) -> None:
        for frame in () if self.bus_off else frames:
            if self.corrupt and self._random.random() < self.corrupt:
                self._put(_error_frame(BUS_ERROR))
                continue
            message = can.Message(
                arbitration_id=frame.identifier,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote_length is not None,
                dlc=frame.remote_length,
                data=None if frame.remote_length is not None else frame.data,
            )
            self._put(message)

    def _put(self, message: can.Message) -> None:
        if self._bus is None:
            return
        try:
            self._bus.send(message, timeout=0)
        except can.CanOperationError:
            # A full transmit queue, or nobody to acknowledge: the frame is lost, as on a bus.
            self.refused_frames += 1


def _error_frame(error_class: int) -> can.Message:
    return can.Message(
        arbitration_id=error_class, is_error_frame=True, is_extended_id=False, data=bytes(8)
    )


def _descriptor(bus: can.BusABC) -> int | None:
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        return None
    return descriptor if descriptor >= 0 else None
