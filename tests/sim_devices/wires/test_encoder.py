"""The encoder node: boot-up, network management, SYNC, PDO set-up, heartbeats, emergencies."""

from __future__ import annotations

import pytest

from recordings.rig import Rig
from sim_devices.can_bus import Frame
from sim_devices.canopen import Encoder
from sim_devices.canopen.node import NmtState

SYNC = Frame(0x080)


def frame(identifier: int, data: str = "") -> Frame:
    return Frame(identifier, bytes.fromhex(data))


@pytest.fixture
def encoder(arm: Rig, plant) -> Encoder:
    made = Encoder(1, "encoder1", arm.channel("q1"), plant)
    assert made.tick(0.0) == [frame(0x701, "00")]
    return made


@pytest.fixture
def running_encoder(encoder: Encoder) -> Encoder:
    assert encoder.receive(frame(0x000, "01 01"), 0.0) == []
    return encoder


def sdo(node: Encoder, request: str, time_s: float = 0.0) -> str:
    (answer,) = node.receive(frame(0x601, request), time_s)
    assert answer.identifier == 0x581
    return answer.data.hex(" ")


def test_boots_once(encoder: Encoder) -> None:
    assert encoder.tick(0.1) == []
    assert encoder.state is NmtState.PRE_OPERATIONAL


def test_position_travels_on_sync(running_encoder: Encoder, plant) -> None:
    plant.counts["q1"] = 200_000  # 0x00030D40
    # Counter from 1, device time in 100 us: 1.0 s is 10,000 = 0x2710.
    assert running_encoder.receive(SYNC, 1.0) == [frame(0x181, "40 0d 03 00 01 00 10 27")]
    plant.counts["q1"] = 399_999
    assert running_encoder.receive(SYNC, 1.00505) == [frame(0x181, "7f 1a 06 00 02 00 42 27")]


def test_counter_and_device_time_wrap(running_encoder: Encoder) -> None:
    for _ in range(0x10000):
        last = running_encoder.receive(SYNC, 6.5537)
    assert last == [frame(0x181, "00 00 00 00 00 00 01 00")]


def test_sync_with_counter_is_a_sync(running_encoder: Encoder) -> None:
    assert len(running_encoder.receive(frame(0x080, "07"), 0.0)) == 1


def test_reading_by_sdo_leaves_the_counter_alone(running_encoder: Encoder, plant) -> None:
    plant.counts["q1"] = 5
    assert sdo(running_encoder, "40 04 60 00 00 00 00 00") == "43 04 60 00 05 00 00 00"
    assert sdo(running_encoder, "40 00 20 00 00 00 00 00") == "4b 00 20 00 00 00 00 00"
    assert running_encoder.receive(SYNC, 0.0) == [frame(0x181, "05 00 00 00 01 00 00 00")]


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 96 01 01 00"),  # CiA 406, single-turn rotary
        ("40 01 10 00 00 00 00 00", "4f 01 10 00 00 00 00 00"),
        ("40 05 10 00 00 00 00 00", "43 05 10 00 80 00 00 00"),
        ("40 08 10 00 00 00 00 00", "41 08 10 00 17 00 00 00"),
        ("40 14 10 00 00 00 00 00", "43 14 10 00 81 00 00 00"),
        ("40 18 10 00 00 00 00 00", "4f 18 10 00 04 00 00 00"),
        ("40 18 10 02 00 00 00 00", "43 18 10 02 96 01 00 00"),
        ("40 01 60 00 00 00 00 00", "43 01 60 00 80 1a 06 00"),  # 400,000 counts a turn
        ("40 00 18 01 00 00 00 00", "43 00 18 01 81 01 00 00"),
        ("40 00 18 02 00 00 00 00", "4f 00 18 02 01 00 00 00"),
        ("40 00 1a 00 00 00 00 00", "4f 00 1a 00 03 00 00 00"),
        ("40 00 1a 01 00 00 00 00", "43 00 1a 01 20 00 04 60"),
    ],
)
def test_objects(encoder: Encoder, request_: str, answer: str) -> None:
    assert sdo(encoder, request_) == answer


@pytest.mark.parametrize(
    ("command", "speaks_sdo", "speaks_pdo", "beat"),
    [("01", True, True, "05"), ("80", True, False, "7f"), ("02", False, False, "04")],
)
@pytest.mark.parametrize("address", ["00", "01"])
def test_network_management(
    running_encoder: Encoder,
    command: str,
    speaks_sdo: bool,
    speaks_pdo: bool,
    beat: str,
    address: str,
) -> None:
    sdo(running_encoder, "2b 17 10 00 64 00 00 00")  # heartbeat every 100 ms
    running_encoder.receive(frame(0x000, command + address), 0.0)
    ask = frame(0x601, "40 00 10 00 00 00 00 00")
    assert bool(running_encoder.receive(ask, 0.0)) == speaks_sdo
    assert bool(running_encoder.receive(SYNC, 0.0)) == speaks_pdo
    assert running_encoder.tick(0.1) == [frame(0x701, beat)]


@pytest.mark.parametrize("data", ["01 02", "01", "01 01 00", "", "ff 01"])
def test_command_for_another_node_or_malformed_is_ignored(encoder: Encoder, data: str) -> None:
    assert encoder.receive(frame(0x000, data), 0.0) == []
    assert encoder.state is NmtState.PRE_OPERATIONAL


@pytest.mark.parametrize("command", ["81", "82"])
def test_reset_boots_again_with_power_on_values(running_encoder: Encoder, command: str) -> None:
    running_encoder.receive(SYNC, 0.0)
    sdo(running_encoder, "2f 00 18 02 0a 00 00 00")
    assert running_encoder.receive(frame(0x000, command + "00"), 1.0) == []
    assert running_encoder.tick(1.005) == [frame(0x701, "00")]
    assert sdo(running_encoder, "40 00 18 02 00 00 00 00") == "4f 00 18 02 01 00 00 00"
    running_encoder.receive(frame(0x000, "01 01"), 1.01)
    samples = running_encoder.receive(SYNC, 1.01)[0].data[4]
    # Only a reset of the node itself begins its samples anew.
    assert samples == {"81": 1, "82": 2}[command]


def test_transmission_on_every_third_sync(running_encoder: Encoder) -> None:
    sdo(running_encoder, "2f 00 18 02 03 00 00 00")
    sent = [len(running_encoder.receive(SYNC, 0.0)) for _ in range(7)]
    assert sent == [0, 0, 1, 0, 0, 1, 0]


@pytest.mark.parametrize("value", ["00", "f1", "fc", "fd"])
def test_transmission_types_that_are_refused(encoder: Encoder, value: str) -> None:
    answer = sdo(encoder, f"2f 00 18 02 {value} 00 00 00")
    assert answer == "80 00 18 02 30 00 09 06"


def test_event_timer(encoder: Encoder) -> None:
    sdo(encoder, "2f 00 18 02 fe 00 00 00")
    sdo(encoder, "2b 00 18 05 32 00 00 00")  # 50 ms
    assert len(encoder.receive(frame(0x000, "01 00"), 1.0)) == 1
    assert encoder.receive(SYNC, 1.01) == []
    assert encoder.tick(1.049) == []
    assert encoder.tick(1.051)[0].data[4] == 2


def test_mapping_is_changed_as_the_standard_asks(encoder: Encoder, plant) -> None:
    plant.counts["q1"] = 7
    device_state, not_mappable, too_long = "22 00 00 08", "41 00 04 06", "42 00 04 06"
    assert sdo(encoder, "2f 00 1a 00 00 00 00 00").endswith(device_state)
    assert sdo(encoder, "23 00 18 01 81 01 00 80").startswith("60")  # PDO does not exist
    assert sdo(encoder, "23 00 1a 01 20 00 04 60").endswith(device_state)
    assert sdo(encoder, "2f 00 1a 00 00 00 00 00").startswith("60")
    assert sdo(encoder, "23 00 1a 01 10 00 04 60").endswith(not_mappable)  # wrong length
    assert sdo(encoder, "23 00 1a 01 20 00 00 10").endswith(not_mappable)  # device type
    assert sdo(encoder, "23 00 1a 01 20 00 04 70").endswith("00 00 02 06")  # no such object
    for slot in ("01", "02", "03"):
        assert sdo(encoder, f"23 00 1a {slot} 20 00 04 60").startswith("60")
    assert sdo(encoder, "2f 00 1a 00 03 00 00 00").endswith(too_long)
    assert sdo(encoder, "2f 00 1a 00 01 00 00 00").startswith("60")
    assert sdo(encoder, "23 00 18 01 85 02 00 00").startswith("60")  # another COB-ID
    encoder.receive(frame(0x000, "01 00"), 0.0)
    assert encoder.receive(SYNC, 0.0) == [frame(0x285, "07 00 00 00")]
    assert sdo(encoder, "23 00 18 01 81 01 00 00").endswith(device_state)


def test_heartbeats_keep_their_period_and_do_not_pile_up(encoder: Encoder) -> None:
    sdo(encoder, "2b 17 10 00 0a 00 00 00")  # 10 ms
    ticks = [0.001 * n for n in range(1, 101)]
    assert sum(len(encoder.tick(time_s)) for time_s in ticks) == 10
    assert len(encoder.tick(5.0)) == 1
    assert encoder.tick(5.005) == []
    sdo(encoder, "2b 17 10 00 00 00 00 00")
    assert encoder.tick(9.0) == []


def test_loss_of_the_watched_heartbeat(running_encoder: Encoder) -> None:
    sdo(running_encoder, "23 16 10 01 64 00 7f 00")  # node 127, 100 ms
    # The watch begins with the first beat, and beats of others do not count.
    assert running_encoder.tick(5.0) == []
    running_encoder.receive(frame(0x77F, "05"), 5.0)
    running_encoder.receive(frame(0x77E, "05"), 5.09)
    assert running_encoder.tick(5.1) == []
    assert running_encoder.tick(5.105) == [frame(0x081, "30 81 11 00 00 00 00 00")]
    assert running_encoder.state is NmtState.PRE_OPERATIONAL
    assert running_encoder.tick(6.0) == []
    assert sdo(running_encoder, "40 01 10 00 00 00 00 00") == "4f 01 10 00 11 00 00 00"
    assert sdo(running_encoder, "40 03 10 01 00 00 00 00") == "43 03 10 01 30 81 00 00"
    running_encoder.receive(frame(0x77F, "05"), 7.0)
    assert running_encoder.tick(7.005) == [frame(0x081, "00 00 00 00 00 00 00 00")]
    assert sdo(running_encoder, "40 03 10 00 00 00 00 00") == "4f 03 10 00 01 00 00 00"
    assert sdo(running_encoder, "2f 03 10 00 00 00 00 00").startswith("60")
    assert sdo(running_encoder, "40 03 10 00 00 00 00 00") == "4f 03 10 00 00 00 00 00"


def test_watch_set_up_anew_forgets_the_loss(encoder: Encoder) -> None:
    sdo(encoder, "23 16 10 01 64 00 7f 00")
    encoder.receive(frame(0x77F, "05"), 5.0)
    assert encoder.tick(6.0) == [frame(0x081, "30 81 11 00 00 00 00 00")]
    sdo(encoder, "23 16 10 01 64 00 7f 00", 7.0)
    assert encoder.tick(7.005) == [frame(0x081, "00 00 00 00 00 00 00 00")]
    assert sdo(encoder, "40 01 10 00 00 00 00 00") == "4f 01 10 00 00 00 00 00"


def test_frames_that_are_not_for_it(running_encoder: Encoder) -> None:
    for other in (
        Frame(0x602, bytes(8)),
        Frame(0x080, extended=True),
        Frame(0x181, remote_length=8),
        Frame(0x7FF, b""),
        Frame(0x200, bytes(8)),
    ):
        assert running_encoder.receive(other, 0.0) == []
