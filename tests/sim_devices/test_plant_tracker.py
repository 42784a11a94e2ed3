"""What nature lets a tracker see, and lines that read their change of length, in step with a clock."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.shoulder_table1 import TRACKER
from recordings.rig import load_rig, parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.live import make_plant
from sim_devices.plant.quaternion import IDENTITY, about
from sim_devices.plant.session import play
from sim_devices.plant.tracker import Trackers


def test_a_marker_is_seen_from_where_the_tracker_stands() -> None:
    """By hand: a quarter turn of the plate about z, a camera on the z axis that looks back down."""
    rig = parse_rig(rig_text("shoulder")[0] + "\n" + TRACKER.read_text("utf-8"))
    values = dict.fromkeys([f"camera.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")], 0.0)
    values |= {f"m{k}.{axis}": 0.0 for k in (1, 2, 3) for axis in "xyz"}
    values |= {"camera.z": 2.0, "camera.rx": np.pi, "m1.x": 0.1}
    turned = np.stack([IDENTITY, about(np.array([0.0, 0.0, 1.0]), np.array(np.pi / 2))])
    seen = Trackers(rig, values).seen(turned, np.zeros((2, 3)))
    np.testing.assert_allclose(seen[:, :3], [[0.1, 0.0, 2.0], [0.0, -0.1, 2.0]], atol=1e-12)


def test_lines_read_nothing_where_they_were_set_to_zero() -> None:
    rig = load_rig("hangprinter")
    plant = make_plant(make_nature(rig, 1))
    noise = [plant.sense(channel.name) / channel.noise for channel in rig.channels]
    assert np.abs(noise).max() < 5.0


def test_a_tracker_in_step_with_a_clock_sees_what_the_whole_session_has() -> None:
    text = rig_text("shoulder")[0] + "\n" + TRACKER.read_text("utf-8")
    rig = parse_rig(text)
    course = play(make_nature(rig, 3)).course
    plant = make_plant(make_nature(rig, 3))
    plant.sense("d1")
    for moment in (1.0, 2.5):
        plant.advance(moment)
        k = int(np.argmin(np.abs(course.time_s - moment)))
        for name in ("m1x", "m2y", "m3z"):
            seen = plant.sense(name) * 1e-6
            expected = course.value[name][k]
            assert seen == pytest.approx(expected, abs=1e-3)
