"""Drives of another controller: what their rig must say."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.canopen.listener import CanopenListener, ListenerOptions
from drivers.dbc.drive_messages import DbcDriveOptions
from drivers.dbc.listener import DbcListener
from drivers.driver import DeviceSpec
from drivers.errors import OptionError

DBC = (Path(__file__).parent / "bench.dbc").read_text("utf-8")


def canopen(joint, channels=()) -> CanopenListener:
    options = ListenerOptions.model_validate({"node_id": 17})
    return CanopenListener(
        DeviceSpec("drive1", "canopen-listener", "bus", joint, channels, options)
    )


def dbc(joint, channels=()) -> DbcListener:
    options = DbcDriveOptions(
        command="DriveCommand",
        status="DriveStatus",
        mode="Mode",
        reported_mode="Shown",
        modes={"off": 0},
    )
    return DbcListener(DeviceSpec("drive1", "dbc-listener", "bus", joint, channels, options, DBC))


@pytest.mark.parametrize(("make", "reads_it"), [(canopen, "sensor's device"), (dbc, "dbc-encoder")])
def test_a_listener_needs_a_joint_and_delivers_no_channel(make, reads_it, channel):
    assert make("joint1").joint == "joint1"
    with pytest.raises(OptionError, match="device 'drive1' is a listener; say which 'joint'"):
        make(None)
    with pytest.raises(OptionError, match=f"'q1' names the listener 'drive1'.*{reads_it}"):
        make("joint1", (channel("q1"),))
