"""A CANopen node (CiA 301): network management, SDO, SYNC, PDOs, heartbeat and emergencies.

Frames in, frames out, told the time; knows no port and no clock. What every node has:

    0x000          NMT commands: 1 start, 2 stop, 0x80 pre-operational, 0x81 reset node,
                   0x82 reset communication; node-ID 0 addresses all
    0x080          SYNC, with or without counter
    0x080 + id     EMCY
    0x580/0x600    SDO responses / requests, + id
    0x700 + id     boot-up (0) and heartbeat (4 stopped, 5 operational, 127 pre-operational)

    0x1000  u32    device type
    0x1001, 0x1003 errors (see `emergency`)
    0x1005  u32    COB-ID SYNC, 0x80
    0x1008  text   device name, begins with "loopcal virtual"
    0x1009  text   hardware version
    0x100A  text   software version
    0x1014  u32    COB-ID EMCY, 0x80 + id
    0x1016, 0x1017 heartbeats (see `heartbeat`)
    0x1018  u32    sub 1 vendor (0, not registered), 2 product code, 3 revision, 4 serial number
    0x1029  u8     sub 1: 0, a communication error ends the operational state
    0x1400 .. 0x1BFF  PDO parameters (see `pdo`)

When the beat of the node watched by 0x1016 stops, the node sends EMCY 0x8130 and leaves the
operational state; when it comes back, or 0x1016 is written anew, EMCY 0x0000. The master
starts the node again.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from enum import IntEnum

from sim_devices.can_bus import Frame
from sim_devices.canopen import emergency
from sim_devices.canopen.dictionary import U8, U32, ObjectDictionary, Refused
from sim_devices.canopen.emergency import Emergencies
from sim_devices.canopen.heartbeat import HeartbeatConsumer, HeartbeatProducer
from sim_devices.canopen.pdo import Pdo, PdoDefaults
from sim_devices.canopen.sdo import SdoServer

DEVICE_NAME_START = "loopcal virtual"
"""How 0x1008 of every virtual node begins: no real device answers so."""

REVISION = 0x0001_0000

NMT, SYNC, EMCY, SDO_RESPONSE, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
START, STOP, ENTER_PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82


class NmtState(IntEnum):
    """Network management state, with the value that a heartbeat shows."""

    BOOTING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


@dataclass(frozen=True, slots=True)
class Identity:
    """What a node says of itself.

    Attributes:
        node_id: 1..127.
        device: name of the device in the rig; the serial number is derived from it.
        model: end of the device name in 0x1008.
        device_type: object 0x1000.
        product_code: object 0x1018 sub 2.
    """

    node_id: int
    device: str
    model: str
    device_type: int
    product_code: int


class Node:
    """The communication profile. A device profile derives from it and overrides the hooks."""

    receive_pdos: tuple[PdoDefaults, ...] = ()
    transmit_pdos: tuple[PdoDefaults, ...] = ()

    def __init__(self, identity: Identity) -> None:
        self.identity = identity
        self.state = NmtState.BOOTING
        self.time_s = 0.0
        self._out: list[Frame] = []
        self._power_on()

    # What the bus calls.

    def receive(self, frame: Frame, time_s: float) -> list[Frame]:
        """Hear one frame; returns what the node sends at once."""
        self.time_s = time_s
        if frame.extended or frame.remote_length is not None:
            return []
        if frame.identifier == NMT:
            self._manage(frame.data)
        elif frame.identifier & ~0x7F == HEARTBEAT:
            self._hear_heartbeat(frame)
        elif self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
            self._communicate(frame)
        return self._flush()

    def tick(self, time_s: float) -> list[Frame]:
        """Let time pass: boot-up, heartbeats, watch, event-driven PDOs."""
        self.time_s = time_s
        if self.state is NmtState.BOOTING:
            self._send(HEARTBEAT, bytes([NmtState.BOOTING]))
            self._enter(NmtState.PRE_OPERATIONAL)
        if self._consumer.expires(time_s):
            self.begin_emergency(emergency.HEARTBEAT_LOST)
            self._on_master_lost()
            if self.state is NmtState.OPERATIONAL:
                self._enter(NmtState.PRE_OPERATIONAL)
        elif not self._consumer.expired:
            # The beat is back, or the master has set up its watch anew.
            self.end_emergency(emergency.HEARTBEAT_LOST)
        self._on_tick()
        if self._producer.due(time_s):
            self._send(HEARTBEAT, bytes([self.state]))
        return self._flush()

    # What a device profile uses.

    @property
    def master_lost(self) -> bool:
        """Whether the watched heartbeat stopped and has not come back."""
        return self._consumer.expired

    def begin_emergency(self, code: int) -> None:
        """An error is present: announced once, kept in the error register until it ends."""
        self._send_emergency(self._emergencies.begin(code))

    def end_emergency(self, code: int) -> None:
        """An error has gone: announced if it was present."""
        self._send_emergency(self._emergencies.end(code))

    def object_changed(self, index: int) -> None:
        """An object has a new value: event-driven PDOs that map it are sent."""
        for pdo in self._transmit:
            pdo.event(index)

    # What a device profile overrides.

    def _install_application(self, dictionary: ObjectDictionary) -> None:
        """Put the objects of the device profile into the dictionary, at power-on values."""

    def _on_nmt(self, state: NmtState) -> None:
        """Network management has entered ``state``."""

    def _on_tick(self) -> None:
        """Time has passed; ``time_s`` says how far."""

    def _on_master_lost(self) -> None:
        """The watched heartbeat has stopped: go to the safe state."""

    def _before_transmit(self, pdo: Pdo) -> None:
        """The values mapped in ``pdo`` are about to be read and sent."""

    # Network management.

    def _power_on(self) -> None:
        self._dictionary = ObjectDictionary()
        self._install_application(self._dictionary)
        self._set_up_communication()

    def _set_up_communication(self) -> None:
        identity, dictionary = self.identity, self._dictionary
        dictionary.add(0x1000, 0, U32, read=identity.device_type)
        dictionary.add(0x1005, 0, U32, read=SYNC)
        dictionary.add_text(0x1008, f"{DEVICE_NAME_START} {identity.model}")
        dictionary.add_text(0x1009, "virtual")
        dictionary.add_text(0x100A, "1.0")
        dictionary.add(0x1014, 0, U32, read=EMCY + identity.node_id)
        dictionary.add(0x1018, 0, U8, read=4)
        dictionary.add(0x1018, 1, U32, read=0)
        dictionary.add(0x1018, 2, U32, read=identity.product_code)
        dictionary.add(0x1018, 3, U32, read=REVISION)
        dictionary.add(0x1018, 4, U32, read=zlib.crc32(identity.device.encode()))
        dictionary.add(0x1029, 0, U8, read=1)
        dictionary.add(0x1029, 1, U8, read=0)
        self._emergencies = Emergencies(dictionary)
        self._consumer = HeartbeatConsumer(dictionary)
        self._producer = HeartbeatProducer(dictionary)
        self._receive = [Pdo(each, dictionary, transmit=False) for each in self.receive_pdos]
        self._transmit = [Pdo(each, dictionary, transmit=True) for each in self.transmit_pdos]
        self._waiting: dict[int, bytes] = {}
        self._sdo = SdoServer(dictionary)

    def _manage(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.identity.node_id):
            return
        command = data[0]
        if command == START:
            self._enter(NmtState.OPERATIONAL)
        elif command == STOP:
            self._enter(NmtState.STOPPED)
        elif command == ENTER_PRE_OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif command in (RESET_NODE, RESET_COMMUNICATION):
            self._enter(NmtState.BOOTING)
            if command == RESET_NODE:
                self._power_on()
            else:
                self._set_up_communication()

    def _enter(self, state: NmtState) -> None:
        if state is self.state:
            return
        self.state = state
        self._waiting.clear()
        if state is NmtState.OPERATIONAL:
            for pdo in self._transmit:
                pdo.start(self.time_s)
        self._on_nmt(state)

    # Communication objects.

    def _communicate(self, frame: Frame) -> None:
        if frame.identifier == SDO_REQUEST + self.identity.node_id:
            response = self._sdo.answer(frame.data)
            if response is not None:
                self._send(SDO_RESPONSE, response)
        elif self.state is not NmtState.OPERATIONAL:
            return
        elif frame.identifier == SYNC:
            self._synchronise()
        else:
            for pdo in self._receive:
                if pdo.exists and pdo.identifier == frame.identifier:
                    self._take(pdo, frame.data)

    def _synchronise(self) -> None:
        for pdo in self._receive:
            if pdo.number in self._waiting:
                self._apply(pdo, self._waiting.pop(pdo.number))
        for pdo in self._transmit:
            if pdo.sync():
                self._transmit_now(pdo)

    def _take(self, pdo: Pdo, data: bytes) -> None:
        if len(data) < pdo.length:
            self._send_emergency(self._emergencies.note(emergency.PDO_NOT_PROCESSED))
        elif pdo.on_sync:
            self._waiting[pdo.number] = data
        else:
            self._apply(pdo, data)

    def _apply(self, pdo: Pdo, data: bytes) -> None:
        try:
            pdo.apply(data)
        except Refused:
            # A PDO has no response: the emergency is all that the master learns.
            self._send_emergency(self._emergencies.note(emergency.PDO_VALUE_REFUSED))

    def _hear_heartbeat(self, frame: Frame) -> None:
        if len(frame.data) == 1:
            self._consumer.hear(frame.identifier & 0x7F, self.time_s)

    def _transmit_now(self, pdo: Pdo) -> None:
        self._before_transmit(pdo)
        self._out.append(Frame(pdo.identifier, pdo.content(self.time_s)))

    def _send(self, base: int, data: bytes) -> None:
        self._out.append(Frame(base + self.identity.node_id, data))

    def _send_emergency(self, data: bytes | None) -> None:
        if data is not None and self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
            self._send(EMCY, data)

    def _flush(self) -> list[Frame]:
        if self.state is NmtState.OPERATIONAL:
            for pdo in self._transmit:
                if pdo.due(self.time_s):
                    self._transmit_now(pdo)
        out, self._out = self._out, []
        return out
