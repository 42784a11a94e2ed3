"""The master of a CANopen bus: SYNC, heartbeat, emergencies, boot-ups, and SDO for all its nodes.

Wire contract, beside that of the devices:

    SYNC       0x080, no data    sent at the sample rate on a schedule without drift, while sampling
    NMT        0x000  01 id      each node of the rig is started, no other
    heartbeat  0x700 + master_id  05   every 0.1 s while the bus is served, a drive wants it, and
                                       whoever supervises vouches for the drives
    EMCY       0x080 + id        error code, 2 bytes little-endian: an EMERGENCY fault
    boot-up    0x700 + id  00    a RESTARTED fault; the node is set up again. Of a node that the rig
                                 does not name: a FOREIGN fault, for it may have a wrong id
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from canopen import Network
from canopen.emcy import EmcyError

from drivers.can_bus import Frame
from drivers.can_device import CanWire
from drivers.canopen.device import CanopenDevice
from drivers.canopen.node_ids import master_id_of
from drivers.canopen.sdo import SDO_LENGTH, Sdo
from drivers.errors import Malformed
from drivers.schedule import SECOND, Schedule
from recordings.events import Event
from recordings.faults import FaultKind

HEARTBEAT_HZ = 10.0
NMT, SYNC, EMCY, SDO_ANSWER, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x700
NMT_START, OPERATIONAL = 0x01, 0x05
FUNCTION = 0x780
"""Bits of a CANopen identifier that say what a frame is; the others are the node id."""


class _Network(Network):
    """The package's network, sending through our bus."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(can_id, bytes(data))


class CanopenMaster:
    """The one master of all nodes that a rig has on one port. See `drivers.can_device.CanService`.

    Raises:
        OptionError: two devices have one node id, or drives disagree about the master's.
    """

    def __init__(self, port: str, nodes: Sequence[CanopenDevice]) -> None:
        self.name = port
        self._nodes = {node.node_id: node for node in nodes}
        self._master_id = master_id_of(port, nodes)
        self.identifiers = (
            *(function + node_id for function in (EMCY, SDO_ANSWER) for node_id in self._nodes),
            *(HEARTBEAT + node_id for node_id in range(1, 128) if node_id != self._master_id),
        )
        self._heartbeat: Schedule | None = None
        self._vouched_until_ns = 0

    def attach(self, wire: CanWire) -> None:
        """Belong to a bus."""
        self._wire = wire
        self._network = _Network(wire.send)
        for node in self._nodes.values():
            node.attach(self)

    def now_ns(self) -> int:
        """Time of the session."""
        return self._wire.now_ns()

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame; raises LinkBroken or LinkClosed."""
        self._wire.send(identifier, data)

    def sdo(self, node_id: int) -> Sdo:
        """Access to the object dictionary of a node."""
        return Sdo(self._network, node_id, self._wire.await_answer)

    def vouch(self, until_ns: int) -> None:
        """Whoever supervises the drives does so; the heartbeat is sent until ``until_ns``."""
        self._vouched_until_ns = until_ns

    def open(self, now_ns: int) -> None:
        """The port has been opened: the schedule of the heartbeat begins."""
        self._heartbeat = Schedule(HEARTBEAT_HZ, now_ns)

    def serve(self, now_ns: int) -> Sequence[Event]:
        """Send the heartbeat when it is due, while somebody vouches for the drives."""
        due = self._heartbeat is not None and self._heartbeat.due(now_ns)
        if due and self._master_id and now_ns < self._vouched_until_ns:
            self.send(HEARTBEAT + self._master_id, bytes([OPERATIONAL]))
        return ()

    def due_ns(self) -> int | None:
        """When the next heartbeat is due."""
        return None if self._heartbeat is None else self._heartbeat.next_ns

    def sample(self, now_ns: int) -> Sequence[Event]:
        """Send SYNC, if a node answers it."""
        if any(node.tallies for node in self._nodes.values()):
            self.send(SYNC, b"")
        return [event for node in self._nodes.values() for event in node.sync(now_ns)]

    def receive(self, frame: Frame) -> Sequence[Event]:
        """Take an SDO answer, an emergency or a boot-up."""
        function, node_id = frame.identifier & FUNCTION, frame.identifier & ~FUNCTION
        node = self._nodes.get(node_id)
        if node is None:
            if frame.data[:1] == b"\0" and not self._wire.is_wanted(frame.identifier):
                text = (
                    f"node {node_id} has booted, which the rig does not name on port '{self.name}'"
                )
                self._wire.fault(frame.time_ns, self.name, FaultKind.FOREIGN, text)
            return ()
        if function == EMCY:
            return self._take_emergency(node, frame)
        if function == HEARTBEAT:
            if frame.data[:1] == b"\0":
                self._take_boot_up(node, frame)
        elif len(frame.data) == SDO_LENGTH:
            self._network.notify(frame.identifier, bytearray(frame.data), frame.time_ns / SECOND)
        return ()

    def _take_emergency(self, node: CanopenDevice, frame: Frame) -> Sequence[Event]:
        if len(frame.data) < 2:
            text = f"{node.name}: an EMCY of {len(frame.data)} bytes, expected 8"
            self._wire.fault(frame.time_ns, node.name, FaultKind.MALFORMED, text)
            return ()
        code = int.from_bytes(frame.data[:2], "little")
        if code >> 8:
            meaning = EmcyError(code, 0, b"", 0.0).get_desc() or "unknown"
            text = f"{node.name} reports the error 0x{code:04X} ({meaning})"
            self._wire.fault(frame.time_ns, node.name, FaultKind.EMERGENCY, text)
        elif code == 0:
            text = f"{node.name} reports that it has no error any more"
            self._wire.fault(frame.time_ns, node.name, FaultKind.EMERGENCY_OVER, text)
        try:
            return node.emergency(code, frame.time_ns)
        except Malformed as error:
            self._wire.fault(frame.time_ns, node.name, FaultKind.MALFORMED, str(error))
            return ()

    def _take_boot_up(self, node: CanopenDevice, frame: Frame) -> None:
        node.restarted()
        self._wire.restarted(node)
