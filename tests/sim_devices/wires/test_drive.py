"""The drive node: CiA 402 states, what the plant is told, faults, the watch over the master."""

from __future__ import annotations

import pytest

from recordings.rig import Rig
from sim_devices.can_bus import Frame
from sim_devices.canopen import JointDrive
from sim_devices.canopen.drive_states import Command, State, command_of, next_state

SYNC = Frame(0x080)
HERE = 200_000


def frame(identifier: int, data: str = "") -> Frame:
    return Frame(identifier, bytes.fromhex(data))


class Master:
    """The other end of SDO and PDO, in hexadecimal."""

    def __init__(self, node: JointDrive) -> None:
        self.node = node
        self.time_s = 0.0

    def write(self, index: int, value: int, size: int, sub: int = 0) -> bool:
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        head = bytes([0x23 | (4 - size) << 2]) + index.to_bytes(2, "little") + bytes([sub])
        answers = self.node.receive(Frame(0x611, head + data), self.time_s)
        return next(a for a in answers if a.identifier == 0x591).data[0] == 0x60

    def read(self, index: int, sub: int = 0) -> int:
        request = b"\x40" + index.to_bytes(2, "little") + bytes([sub]) + bytes(4)
        answer = self.node.receive(Frame(0x611, request), self.time_s)[0].data
        size = 4 - (answer[0] >> 2 & 3)
        assert answer[0] & 0xE3 == 0x43, answer.hex()
        return int.from_bytes(answer[4 : 4 + size], "little", signed=index in (0x6064, 0x607A))

    def control(self, *words: int) -> int:
        for word in words:
            assert self.write(0x6040, word, 2)
        return self.read(0x6041)

    def enable(self, mode: int) -> None:
        assert self.write(0x6060, mode, 1)
        assert self.control(0x06, 0x07, 0x0F) & 0x6F == 0x27


@pytest.fixture
def drive(arm: Rig, plant) -> JointDrive:
    plant.counts["q1"] = HERE
    made = JointDrive(17, "drive1", "joint1", arm.channel("q1"), plant)
    assert made.tick(0.0) == [frame(0x711, "00")]
    return made


@pytest.fixture
def master(drive: JointDrive) -> Master:
    return Master(drive)


# Every pair of the state table of CiA 402; what is missing has no effect.
CONTROL_WORDS = {
    Command.SHUTDOWN: 0x06,
    Command.SWITCH_ON: 0x07,
    Command.ENABLE_OPERATION: 0x0F,
    Command.DISABLE_VOLTAGE: 0x00,
    Command.QUICK_STOP: 0x02,
}
D, R, S, E, Q = (
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
    State.QUICK_STOP_ACTIVE,
)
TABLE = {
    D: (R, D, D, D, D),
    R: (R, S, E, D, D),
    S: (R, S, E, D, D),
    E: (R, S, E, D, Q),
    Q: (Q, Q, E, D, Q),
    State.FAULT: (State.FAULT,) * 5,
}


@pytest.mark.parametrize("state", TABLE)
def test_state_table(state: State) -> None:
    after = [next_state(state, command_of(word)) for word in CONTROL_WORDS.values()]
    assert tuple(after) == TABLE[state]


@pytest.mark.parametrize(("command", "word"), CONTROL_WORDS.items())
def test_command_coding_ignores_other_bits(command: Command, word: int) -> None:
    assert command_of(word) is command
    assert command_of(word | 0xFFF0) is command


def test_status_words_on_the_way_up(master: Master) -> None:
    # The status words that drives in the field show: 0x0250, 0x0231, 0x0233, 0x0237.
    assert master.read(0x6041) == 0x0250
    assert [master.control(word) for word in (0x06, 0x07, 0x0F)] == [0x0231, 0x0233, 0x0237]
    assert master.control(0x02) == 0x0217
    assert master.control(0x00) == 0x0250


def test_nothing_is_commanded_before_operation_is_enabled(master: Master, plant) -> None:
    assert master.write(0x6060, 1, 1)
    master.control(0x06, 0x07)
    assert plant.commands == []


def test_zero_torque_is_free_and_torque_pushes(master: Master, plant) -> None:
    master.enable(mode=4)
    assert master.write(0x6071, -250, 2)
    assert not master.write(0x6071, 1001, 2)
    assert master.write(0x6071, 0, 2)
    master.control(0x00)
    assert plant.commands == [
        ("joint1", "free", 0),
        ("joint1", "torque", -250),
        ("joint1", "free", 0),
        ("joint1", "off", 0),
    ]


def test_no_mode_is_free(master: Master, plant) -> None:
    master.enable(mode=0)
    assert plant.commands == [("joint1", "free", 0)]


@pytest.mark.parametrize("mode", [2, 3, 6, 8, -1])
def test_other_modes_are_refused(master: Master, mode: int) -> None:
    assert not master.write(0x6060, mode, 1)
    assert master.read(0x6061) == 0


def test_position_mode_holds_until_a_set_point_comes(master: Master, drive, plant) -> None:
    master.enable(mode=1)
    assert plant.commands == [("joint1", "position", HERE)]
    assert master.write(0x607A, HERE + 500, 4)
    assert len(plant.commands) == 1
    assert master.control(0x1F) & 0x1400 == 0x1000  # acknowledged, not reached
    assert plant.commands[-1] == ("joint1", "position", HERE + 500)
    drive.tick(0.1)
    assert not master.read(0x6041) & 0x0400
    plant.counts["q1"] = HERE + 499
    drive.tick(0.2)
    assert master.read(0x6041) & 0x0400
    assert not master.control(0x0F) & 0x1000


def test_set_point_needs_a_rising_edge(master: Master, plant) -> None:
    master.enable(mode=1)
    master.write(0x607A, 100, 4)
    master.control(0x1F)
    master.write(0x607A, 300, 4)
    master.control(0x1F)
    assert plant.commands[-1] == ("joint1", "position", 100)
    master.control(0x0F, 0x1F)
    assert plant.commands[-1] == ("joint1", "position", 300)


def test_relative_set_point(master: Master, plant) -> None:
    master.enable(mode=1)
    master.write(0x607A, 40, 4)
    master.control(0x5F, 0x0F, 0x5F)
    assert plant.commands[-1] == ("joint1", "position", HERE + 80)


@pytest.mark.parametrize("counts", [-1, 400_000])
def test_target_outside_the_count_range_is_refused(master: Master, counts: int) -> None:
    assert not master.write(0x607A, counts, 4)


def test_target_across_the_wrap_is_near(master: Master, drive, plant) -> None:
    plant.counts["q1"] = 399_998
    master.enable(mode=1)
    master.write(0x607A, 3, 4)
    master.control(0x1F)
    drive.tick(0.1)
    assert master.read(0x6041) & 0x0400


@pytest.mark.parametrize(("word", "then"), [(0x10F, "halt"), (0x02, "quick stop")])
def test_halt_and_quick_stop_hold_in_position_mode(
    master: Master, plant, word: int, then: str
) -> None:
    master.enable(mode=1)
    master.write(0x607A, 100, 4)
    master.control(0x1F)
    plant.counts["q1"] = 150_000
    master.control(word)
    assert plant.commands[-1] == ("joint1", "position", 150_000)
    plant.counts["q1"] = 149_990
    assert master.control(0x0F) & 0x6F == 0x27
    assert plant.commands[-1] == ("joint1", "position", 149_990)


@pytest.mark.parametrize("word", [0x10F, 0x02])
def test_halt_and_quick_stop_free_in_torque_mode(master: Master, plant, word: int) -> None:
    master.enable(mode=4)
    master.write(0x6071, 10, 2)
    master.control(word)
    assert plant.commands[-1] == ("joint1", "free", 0)


def test_change_of_mode_while_enabled(master: Master, plant) -> None:
    master.enable(mode=4)
    master.write(0x6060, 1, 1)
    master.write(0x6060, 4, 1)
    modes = [command[1:] for command in plant.commands]
    assert modes == [("free", 0), ("position", HERE), ("free", 0)]


def test_status_travels_on_sync(drive: JointDrive, master: Master) -> None:
    drive.receive(frame(0x000, "01 11"), 0.0)
    assert drive.receive(SYNC, 0.0) == [frame(0x191, "50 02 00 00 00")]
    master.enable(mode=4)
    assert drive.receive(SYNC, 0.0) == [frame(0x191, "37 02 04 00 00")]


def test_status_travels_on_change(drive: JointDrive, master: Master) -> None:
    assert master.write(0x1800, 255, 1, sub=2)
    assert drive.receive(frame(0x000, "01 11"), 0.0) == [frame(0x191, "50 02 00 00 00")]
    assert drive.receive(SYNC, 0.0) == []
    sent = drive.receive(frame(0x211, "06 00 04"), 0.0)
    assert sent == [frame(0x191, "31 02 04 00 00")]
    assert drive.receive(frame(0x211, "06 00 04"), 0.0) == []


def test_inhibit_time_delays_a_change(drive: JointDrive, master: Master) -> None:
    assert not master.write(0x1800, 500, 2, sub=3)
    assert master.write(0x1800, 0x80000191, 4, sub=1)
    assert master.write(0x1800, 500, 2, sub=3)  # 50 ms
    assert master.write(0x1800, 255, 1, sub=2)
    assert master.write(0x1800, 0x191, 4, sub=1)
    assert len(drive.receive(frame(0x000, "01 11"), 1.0)) == 1
    assert drive.receive(frame(0x211, "06 00 04"), 1.01) == []
    assert drive.tick(1.04) == []
    assert drive.tick(1.051) == [frame(0x191, "31 02 04 00 00")]


def test_second_pdo_carries_the_position_when_switched_on(drive, master: Master, plant) -> None:
    assert master.write(0x1801, 0x291, 4, sub=1)
    drive.receive(frame(0x000, "01 11"), 0.0)
    sent = drive.receive(SYNC, 0.0)
    assert sent == [frame(0x191, "50 02 00 00 00"), frame(0x291, "50 02 40 0d 03 00")]


def test_one_pdo_sets_a_target_and_starts_it(drive, master: Master, plant) -> None:
    drive.receive(frame(0x000, "01 11"), 0.0)
    master.enable(mode=1)
    drive.receive(frame(0x311, "1f 00 64 00 00 00"), 0.0)
    assert plant.commands[-1] == ("joint1", "position", 100)
    master.write(0x6060, 4, 1)
    drive.receive(frame(0x411, "0f 00 9c ff aa"), 0.0)  # what is too long is cut
    assert plant.commands[-1] == ("joint1", "torque", -100)


def test_pdo_on_sync_waits_for_it(drive, master: Master, plant) -> None:
    assert master.write(0x1402, 0, 1, sub=2)
    drive.receive(frame(0x000, "01 11"), 0.0)
    master.enable(mode=4)
    drive.receive(frame(0x411, "0f 00 05 00"), 0.0)
    assert plant.commands[-1] == ("joint1", "free", 0)
    drive.receive(SYNC, 0.0)
    assert plant.commands[-1] == ("joint1", "torque", 5)


def test_pdo_before_operational_is_ignored(drive, plant) -> None:
    drive.receive(frame(0x211, "06 00 04"), 0.0)
    assert drive.receive(frame(0x611, "40 41 60 00 00 00 00 00"), 0.0)[0].data[4] == 0x50


@pytest.mark.parametrize(
    ("data", "code"),
    [("0f 00", "10 82 00"), ("0f 00 ff ff ff 7f", "00 82 00")],
)
def test_pdo_too_short_or_out_of_range_is_an_emergency(drive, master, data, code, plant) -> None:
    drive.receive(frame(0x000, "01 11"), 0.0)
    answers = drive.receive(frame(0x311, data), 0.0)
    assert answers == [frame(0x091, code + "00 00 00 00 00")]
    # Nothing of it was obeyed.
    assert master.read(0x6041) == 0x0250


def test_fault_of_the_plant(drive, master: Master, plant) -> None:
    master.enable(mode=1)
    plant.faults["joint1"] = 0x8611
    assert drive.tick(0.1) == [frame(0x091, "11 86 11 00 00 00 00 00")]
    assert plant.commands[-1] == ("joint1", "off", 0)
    assert drive.tick(0.2) == []
    assert master.read(0x603F) == 0x8611
    assert master.read(0x6041) == 0x0218
    # No way out but a fault reset, and not while the cause is there.
    assert master.control(0x06, 0x0F, 0x80) == 0x0218
    plant.faults.clear()
    assert master.control(0x80) == 0x0218  # no rising edge
    assert master.write(0x6040, 0, 2)
    answers = drive.receive(frame(0x611, "2b 40 60 00 80 00 00 00"), 0.0)
    assert frame(0x091, "00 00 00 00 00 00 00 00") in answers
    assert master.read(0x6041) == 0x0250
    assert master.read(0x603F) == 0


def test_loss_of_the_master_unpowers_the_joint(drive, master: Master, plant) -> None:
    drive.receive(frame(0x000, "01 11"), 0.0)
    master.write(0x1016, 0x007F00C8, 4, sub=1)  # node 127, 200 ms
    drive.receive(frame(0x77F, "05"), 1.0)
    master.enable(mode=1)
    drive.tick(1.2)
    assert plant.commands[-1] == ("joint1", "position", HERE)
    assert drive.tick(1.205) == [frame(0x091, "30 81 11 00 00 00 00 00")]
    assert plant.commands[-1] == ("joint1", "off", 0)
    master.time_s = 2.0
    assert master.control(0x00, 0x80) == 0x0218
    drive.receive(frame(0x77F, "05"), 2.0)
    assert master.control(0x00, 0x80) == 0x0250


def test_loss_of_the_master_is_no_fault_of_an_unpowered_drive(drive, master: Master) -> None:
    master.write(0x1016, 0x007F00C8, 4, sub=1)
    drive.receive(frame(0x77F, "05"), 1.0)
    assert drive.tick(2.0) == [frame(0x091, "30 81 11 00 00 00 00 00")]
    master.time_s = 2.0
    assert master.read(0x6041) == 0x0250


def test_stopping_a_powered_node_is_a_fault(drive, master: Master, plant) -> None:
    master.enable(mode=4)
    drive.receive(frame(0x000, "02 11"), 0.0)
    assert plant.commands[-1] == ("joint1", "off", 0)
    drive.receive(frame(0x000, "80 11"), 0.0)
    assert master.read(0x603F) == 0x8100


@pytest.mark.parametrize("command", ["81", "82"])
def test_reset_unpowers_the_joint(drive, master: Master, plant, command: str) -> None:
    master.enable(mode=4)
    drive.receive(frame(0x000, command + "11"), 0.0)
    assert plant.commands[-1] == ("joint1", "off", 0)
    assert drive.tick(0.1) == [frame(0x711, "00")]
    assert master.read(0x6041) == 0x0250
    assert master.read(0x6060) == {"81": 0, "82": 4}[command]


def test_identity(drive, master: Master) -> None:
    assert master.read(0x1000) == 0x00020192
    assert master.read(0x6502) == 0x0009
    assert master.read(0x6064) == HERE
    asked = drive.receive(frame(0x611, "40 08 10 00 00 00 00 00"), 0.0)
    assert asked == [frame(0x591, "41 08 10 00 1b 00 00 00")]
