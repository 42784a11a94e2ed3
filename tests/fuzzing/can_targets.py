"""What comes over CAN: adapters, CANopen, and DBC files."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from unittest.mock import patch

import can

from drivers.can_link import CanLink
from drivers.canopen import cia402, encoder, joint, sdo
from drivers.canopen.sdo import answers
from drivers.dbc.database import DbcFile
from drivers.driver import DeviceSpec
from drivers.errors import Malformed, OptionError
from drivers.slcan import CR, Garbled, LineBuffer
from drivers.slcan import decode as decode_slcan
from drivers.slcan import encode as encode_slcan
from drivers.socketcand import ElementBuffer
from drivers.socketcand import decode as decode_socketcand
from recordings.events import Reading
from recordings.rig import CanPort, Channel
from tests.fuzzing.target import Target

NODE, DRIVE = 5, 6
START_NS = 1_700_000_000_000_000_000


def _lines() -> Sequence[bytes]:
    frames = [
        can.Message(arbitration_id=0x185, data=bytes(range(8)), is_extended_id=False),
        can.Message(arbitration_id=0x1FFFFFFF, data=b"\xff", is_extended_id=True),
        can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, dlc=3),
        can.Message(arbitration_id=0, data=b"", is_extended_id=False),
    ]
    plain = b"".join(map(encode_slcan, frames))
    return [plain, b"t1238AABBCCDDEEFF0011EA5F\rz\rZ\r\aV1013\rN1234\rF00\r", plain * 3]


def _check_slcan(data: bytes) -> None:
    """A line is a frame that would be written so, or none; and cutting does not depend on blocks."""
    whole, bits = LineBuffer(), LineBuffer()
    lines = whole.feed(data)
    if len(max(data.replace(b"\a", CR).split(CR), key=len)) < 20:
        assert lines == [line for byte in data for line in bits.feed(bytes([byte]))]
    for line in lines:
        with suppress(Garbled):
            message = decode_slcan(line)
            if message is not None:
                assert len(message.data) == (0 if message.is_remote_frame else message.dlc)
                again = encode_slcan(message).removesuffix(CR)
                assert line[:1] + line[1:].upper() in (again, again + line[-4:].upper())


def _check_socketcand(data: bytes) -> None:
    for element in ElementBuffer().feed(data):
        message = decode_socketcand(element)
        if message is not None and not message.is_error_frame:
            assert message.arbitration_id <= 0x1FFF_FFFF
            assert len(message.data) == message.dlc <= 8


def _check_pdos(data: bytes) -> None:
    for at in range(0, max(len(data), 1), 8):
        frame = data[at : at + 8]
        with suppress(Malformed):
            sample = encoder.decode(frame)
            assert 0 <= sample.position < 2**32
        with suppress(Malformed):
            status, display = cia402.decode(frame)
            cia402.mode_of(cia402.state_of(status), display or 0, 0)
        if len(frame) == 8:
            answers(frame[::-1], frame)


class _Clock:
    def __init__(self) -> None:
        self.time_ns = START_NS

    def now_ns(self) -> int:
        self.time_ns += 1_000_000
        return self.time_ns


class _Bus:
    """Gives the frames of a script, then none."""

    def __init__(self, frames: Sequence[can.Message]) -> None:
        self.frames = deque(frames)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.frames.popleft() if self.frames else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None: ...
    def shutdown(self) -> None: ...


_RELEVANT = (0x80 + NODE, 0x180 + NODE, 0x180 + DRIVE, 0x580 + NODE, 0x700 + NODE, 0x700 + DRIVE)


def _frames(data: bytes) -> list[can.Message]:
    """Records of 11 bytes: which identifier, kind, length, 8 bytes of payload."""
    out = []
    for at in range(0, min(len(data), 1000) - 10, 11):
        which, kind, length = data[at], data[at + 1], data[at + 2] % 9
        identifier = _RELEVANT[which] if which < len(_RELEVANT) else which * 8
        out.append(
            can.Message(
                arbitration_id=identifier,
                is_extended_id=kind == 1,
                is_remote_frame=kind == 2,
                is_error_frame=kind == 3,
                dlc=length,
                data=None if kind == 2 else data[at + 3 : at + 3 + length],
            )
        )
    return out


def _bus_seeds() -> Sequence[bytes]:
    pdos = b"".join(bytes([1, 0, 8]) + struct.pack("<IHH", 1000 + i, i, 10 * i) for i in range(20))
    emcy = bytes([0, 0, 8]) + struct.pack("<H", 0x8110) + bytes(6)
    boot, status = bytes([4, 0, 1]) + bytes(8), bytes([2, 0, 3, 0x37, 0x12, 1]) + bytes(5)
    return [
        pdos,
        pdos[:55] + emcy + boot + pdos[55:] + status,
        status + bytes([5, 0, 1]) + bytes(8),
    ]


def _check_bus(data: bytes) -> None:
    """Whatever comes on the bus: no error gets out, and every reading is in the balance."""
    channel = Channel.model_validate(
        {"name": "q1", "senses": "base", "device": "enc", "gain_deg_per_count": 1.0}
    )
    devices = [
        encoder.Encoder(
            DeviceSpec(
                "enc",
                "canopen-encoder",
                "can",
                None,
                (channel,),
                encoder.EncoderOptions(node_id=NODE),
            )
        ),
        joint.CanopenJoint(
            DeviceSpec(
                "drive", "canopen-joint", "can", "base", (), joint.JointOptions(node_id=DRIVE)
            )
        ),
    ]
    port = CanPort(kind="can", name="can", interface="virtual", channel="fuzz")
    bus = _Bus(_frames(data))
    link = CanLink(port, devices, _Clock(), connect=lambda _: bus)
    link.open()
    received: Counter[str] = Counter()
    # Nobody answers a device that is set up again after a boot-up; that need not take long.
    with patch.object(sdo, "SDO_TIMEOUT_S", 0.001):
        while bus.frames:
            for event in link.pump(0.0):
                if isinstance(event, Reading):
                    received[event.channel] += 1
                    assert 0 <= event.raw < 2**32
    link.stop()
    balance = link.losses()["q1"]
    lost = balance.dropped_by_device + balance.lost_in_gaps
    assert balance.expected == received["q1"] + lost, balance
    link.close()


DBC = """\
VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 291 Angles: 8 ECU
 SG_ Counter : 0|8@1+ (1,0) [0|255] "" ECU
 SG_ Angle : 8|24@1- (0.001,0) [0|0] "deg" ECU
 SG_ Big : 39|16@0+ (1,0) [0|0] "" ECU
BO_ 2147484000 Mux: 8 ECU
 SG_ Which M : 0|4@1+ (1,0) [0|15] "" ECU
 SG_ A m0 : 8|16@1+ (1,0) [0|0] "" ECU
 SG_ B m1 : 8|16@1- (1,0) [0|0] "" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 291 10;
"""


def _check_dbc(data: bytes) -> None:
    with suppress(OptionError):
        file = DbcFile(data.decode("utf-8", "replace"), "the file")
        for name in ("Angles", "Mux"):
            message = file.message(name)
            for signal in message.signal_names:
                with suppress(Malformed):
                    file.find(f"{name}.{signal}")[0].signal(signal).raw(bytes(range(8)))


TARGETS: tuple[Target, ...] = (
    Target("slcan", _lines, _check_slcan, (b"\r", b"\a", b"t1232", b"T0000", b"_", b" ", b"+")),
    Target(
        "socketcand",
        lambda: [b"< hi >< frame 123 1.5 11 22 >< frame 1FFFFFFF 2.5 >< error 0 1.0 >"],
        _check_socketcand,
        (b"<", b">", b"frame ", b" "),
    ),
    Target("canopen-pdos", lambda: [bytes(range(8)), b"\x37\x12\x01" * 5], _check_pdos),
    Target("canopen-bus", _bus_seeds, _check_bus),
    Target(
        "dbc", lambda: [DBC.encode()], _check_dbc, (b"SG_ ", b"BO_ ", b"@0-", b" M "), text=True
    ),
)
