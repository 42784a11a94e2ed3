"""A third party as judge: the `canopen` package over python-can's slcan, through a real pty."""

from __future__ import annotations

import queue
import struct
import threading
from collections.abc import Callable, Iterator

import canopen
import pytest
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.objectdictionary import datatypes as dt
from canopen.profiles.p402 import BaseNode402

from recordings.rig import Rig

pytestmark = [pytest.mark.wires, pytest.mark.usefixtures("no_leaks")]

PATIENCE_S = 60.0
ENCODER, DRIVE = 1, 17


def variable(index: int, sub: int, name: str, kind: int, access: str = "rw") -> ODVariable:
    made = ODVariable(name, index, sub)
    made.data_type = kind
    made.access_type = access
    return made


def dictionary(receive_pdos: int, transmit_pdos: int) -> canopen.ObjectDictionary:
    """What a master would read from the EDS file of a device with so many PDOs."""
    made = canopen.ObjectDictionary()
    for index, name, kind in (
        (0x1000, "device type", dt.UNSIGNED32),
        (0x1008, "device name", dt.VISIBLE_STRING),
        (0x1017, "heartbeat", dt.UNSIGNED16),
        (0x2000, "sample counter", dt.UNSIGNED16),
        (0x2001, "device time", dt.UNSIGNED16),
        (0x6004, "position", dt.UNSIGNED32),
        (0x603F, "error code", dt.UNSIGNED16),
        (0x6040, "control word", dt.UNSIGNED16),
        (0x6041, "status word", dt.UNSIGNED16),
        (0x6060, "mode", dt.INTEGER8),
        (0x6061, "mode display", dt.INTEGER8),
        (0x6064, "actual position", dt.INTEGER32),
        (0x6071, "target torque", dt.INTEGER16),
        (0x607A, "target position", dt.INTEGER32),
        (0x6502, "supported modes", dt.UNSIGNED32),
    ):
        made.add_object(variable(index, 0, name, kind))
    watch = ODArray("consumer heartbeat", 0x1016)
    watch.add_member(variable(0x1016, 0, "count", dt.UNSIGNED8))
    watch.add_member(variable(0x1016, 1, "node", dt.UNSIGNED32))
    made.add_object(watch)
    for base, count in ((0x1400, receive_pdos), (0x1800, transmit_pdos)):
        for number in range(count):
            communication = ODRecord(f"pdo {base + number:x}", base + number)
            for sub, kind in ((0, dt.UNSIGNED8), (1, dt.UNSIGNED32), (2, dt.UNSIGNED8),
                              (3, dt.UNSIGNED16), (5, dt.UNSIGNED16)):  # fmt: skip
                communication.add_member(variable(base + number, sub, f"c{sub}", kind))
            made.add_object(communication)
            mapping = ODRecord(f"map {base + number:x}", base + 0x200 + number)
            mapping.add_member(variable(base + 0x200 + number, 0, "count", dt.UNSIGNED8))
            for sub in range(1, 9):
                mapping.add_member(variable(base + 0x200 + number, sub, f"m{sub}", dt.UNSIGNED32))
            made.add_object(mapping)
    return made


def await_(condition: Callable[[], bool], what: str) -> None:
    """Wait on real I/O for a condition that has no event of its own."""
    for _ in range(int(PATIENCE_S / 0.005)):
        if condition():
            return
        threading.Event().wait(0.005)
    pytest.fail(f"waited in vain for {what}")


@pytest.fixture
def network(arm_here: Rig, plant, running) -> Iterator[canopen.Network]:
    plant.counts = {f"q{n}": 1000 * n for n in range(1, 8)}
    with running(arm_here, plant) as addresses:
        made = canopen.Network()
        # It does not wait for replies, so there is nothing for its sleep of 2 s to wait for.
        made.connect(
            interface="slcan", channel=addresses["arm-can"], bitrate=1_000_000, sleep_after_open=0.0
        )
        try:
            yield made
        finally:
            made.disconnect()


@pytest.fixture
def encoder(network: canopen.Network) -> canopen.RemoteNode:
    node = canopen.RemoteNode(ENCODER, dictionary(0, 1))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    return node


@pytest.fixture
def drive(network: canopen.Network) -> BaseNode402:
    node = BaseNode402(DRIVE, dictionary(3, 2))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    for name in ("SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
        setattr(node, f"TIMEOUT_{name}", PATIENCE_S)
    return node


def test_sdo_reads_and_writes(encoder: canopen.RemoteNode) -> None:
    assert encoder.sdo[0x1000].raw == 0x00010196
    assert encoder.sdo[0x1008].raw == "loopcal virtual encoder"
    assert encoder.sdo[0x6004].raw == 1000
    encoder.sdo.download(0x1017, 0, struct.pack("<H", 250), force_segment=True)
    assert encoder.sdo[0x1017].raw == 250
    with pytest.raises(canopen.SdoAbortedError) as caught:
        encoder.sdo.upload(0x5FFF, 0)
    assert caught.value.code == 0x06020000
    with pytest.raises(canopen.SdoAbortedError) as caught:
        encoder.sdo.download(0x6004, 0, bytes(4))
    assert caught.value.code == 0x06010002


def test_scanner_finds_every_node(network: canopen.Network) -> None:
    network.scanner.search()
    expected = [1, 2, 3, 4, 5, 17, 18, 19, 20, 21, 22, 23]
    await_(lambda: sorted(network.scanner.nodes) == expected, "all nodes")


def test_position_pdo_on_sync(network: canopen.Network, encoder: canopen.RemoteNode) -> None:
    encoder.tpdo.read()
    received: queue.Queue[tuple[int, ...]] = queue.Queue()
    encoder.tpdo[1].add_callback(lambda pdo: received.put(tuple(item.raw for item in pdo)))
    assert [item.index for item in encoder.tpdo[1]] == [0x6004, 0x2000, 0x2001]
    encoder.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    try:
        samples = [received.get(timeout=PATIENCE_S) for _ in range(50)]
    finally:
        network.sync.stop()
    assert {position for position, _, _ in samples} == {1000}
    assert [counter for _, counter, _ in samples] == list(range(1, 51))
    # Device time of 16 bits: it may wrap, and a busy computer may be late.
    assert len({time for _, _, time in samples}) > 1


def test_pdo_is_set_up_anew_by_the_master(network: canopen.Network, encoder) -> None:
    encoder.tpdo.read()
    pdo = encoder.tpdo[1]
    pdo.clear()
    pdo.add_variable(0x2000)
    pdo.add_variable(0x6004)
    pdo.trans_type = 2
    pdo.save()
    encoder.nmt.state = "OPERATIONAL"
    received: queue.Queue[bytes] = queue.Queue()
    pdo.add_callback(lambda arrived: received.put(bytes(arrived.data)))
    for _ in range(4):
        network.sync.transmit()
    assert [received.get(timeout=PATIENCE_S).hex() for _ in range(2)] == [
        "0100e8030000",
        "0200e8030000",
    ]
    encoder.sdo[0x1017].raw = 10
    encoder.nmt.wait_for_heartbeat(PATIENCE_S)
    assert received.empty()


def test_heartbeat_and_network_management(network: canopen.Network, encoder) -> None:
    beats: queue.Queue[int] = queue.Queue()
    network.subscribe(0x701, lambda _id, data, _time: beats.put(data[0]))
    encoder.sdo[0x1017].raw = 20
    for state, beat in (("OPERATIONAL", 5), ("STOPPED", 4), ("PRE-OPERATIONAL", 127)):
        encoder.nmt.state = state
        # Beats sent before the command may still be on their way.
        await_(lambda beat=beat: beats.get(timeout=PATIENCE_S) == beat, state)
        assert encoder.nmt.state == state
    encoder.nmt.state = "RESET"
    await_(lambda: beats.get(timeout=PATIENCE_S) == 0, "the boot-up")


def test_drive_goes_through_its_states(network: canopen.Network, drive: BaseNode402, plant) -> None:
    drive.nmt.state = "PRE-OPERATIONAL"
    drive.setup_402_state_machine()
    drive.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    try:
        drive.op_mode = "PROFILED POSITION"
        for state in (
            "READY TO SWITCH ON",
            "SWITCHED ON",
            "OPERATION ENABLED",
            "QUICK STOP ACTIVE",
            "OPERATION ENABLED",
            "SWITCH ON DISABLED",
        ):
            drive.state = state
            assert drive.state == state
        drive.op_mode = "PROFILED TORQUE"
        drive.state = "OPERATION ENABLED"
        drive.rpdo[3][0x6040].raw = 0x0F
        drive.rpdo[3][0x6071].raw = -20
        drive.rpdo[3].transmit()
        await_(lambda: plant.commands[-1] == ("joint1", "torque", -20), "the torque")
        drive.op_mode = "PROFILED POSITION"
        drive.rpdo[2][0x6040].raw = 0x1F
        drive.rpdo[2][0x607A].raw = 1234
        drive.rpdo[2].transmit()
        await_(lambda: plant.commands[-1] == ("joint1", "position", 1234), "the set-point")
        await_(lambda: bool(drive.statusword & 0x1000), "the acknowledgement")
    finally:
        network.sync.stop()


def test_fault_is_an_emergency_and_can_be_reset(drive: BaseNode402, plant) -> None:
    drive.sdo[0x6060].raw = 4
    for word in (0x06, 0x07, 0x0F):
        drive.sdo[0x6040].raw = word
    plant.faults["joint1"] = 0x2310
    await_(lambda: bool(drive.emcy.log), "the emergency")
    assert (drive.emcy.log[0].code, drive.emcy.log[0].register) == (0x2310, 0x03)
    assert drive.sdo[0x603F].raw == 0x2310
    assert drive.is_faulted() or drive.sdo[0x6041].raw & 0x4F == 0x08
    plant.faults.clear()
    drive.sdo[0x6040].raw = 0x00
    drive.sdo[0x6040].raw = 0x80
    assert drive.sdo[0x6041].raw & 0x4F == 0x40
    await_(lambda: not drive.emcy.active, "the end of the error")


def test_death_of_the_master_unpowers_the_joint(
    network: canopen.Network, drive: BaseNode402, plant
) -> None:
    drive.sdo[0x1016][1].raw = 127 << 16 | 1000
    beat = network.send_periodic(0x77F, [5], 0.02)
    try:
        drive.sdo[0x6060].raw = 1

        def powered() -> bool:
            # Where the computer stood still for a second, the drive has tripped already.
            for word in (0x80, 0x06, 0x07, 0x0F):
                drive.sdo[0x6040].raw = word
            return ("joint1", "position", 1000) in plant.commands

        await_(powered, "position mode")
    finally:
        beat.stop()
    await_(lambda: bool(drive.emcy.log), "the emergency")
    assert drive.emcy.log[0].code == 0x8130
    await_(lambda: plant.commands[-1] == ("joint1", "off", 0), "the end of its power")
