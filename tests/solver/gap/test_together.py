"""Several sessions of one rig as one recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recordings.reader import Recording, read_recording
from recordings.rig import Plan, parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.errors import NotEnoughData
from solver.gap.together import together
from solver.motion import with_motion
from solver.samples import average

TEXT, SOURCE = rig_text("arm")
RIG = parse_rig(TEXT, SOURCE)
assert RIG.plan is not None
OTHER_PLAN = Plan.model_validate(
    {
        "mode": "driven",
        "sample_hz": 100,
        "drives": ["joint5", "joint6"],
        "targets_deg": [[40, -60], [80, -60], [60, -20]],
        "poses": 3,
        "dwell_s": 0.3,
        "settle_s": 0.15,
        "move_deg_per_s": 90,
        "revisit": {"poses": 3, "visits": 2},
    }
)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Recording]:
    folder = tmp_path_factory.mktemp("sessions")
    simulate(RIG, TEXT, folder / "first.mcap", poses=8, seed=4)
    simulate(RIG, TEXT, folder / "second.mcap", seed=4, plan=OTHER_PLAN)
    return read_recording(folder / "first.mcap"), read_recording(folder / "second.mcap")


def test_one_recording_stays_what_it_is(sessions: tuple[Recording, Recording]) -> None:
    assert together(sessions[:1]) is sessions[0]


def test_every_dwell_reads_as_it_did_by_itself(sessions: tuple[Recording, Recording]) -> None:
    first, second = (average(r) for r in sessions)
    both = average(together(sessions))
    assert len(both.counts) == len(first.counts) + len(second.counts)
    assert np.allclose(both.counts, np.vstack([first.counts, second.counts]))
    poses = np.array([w.pose for w in both.windows])
    assert set(poses[: len(first.counts)]).isdisjoint(poses[len(first.counts) :])


def test_sessions_lie_end_to_end_and_run_by_their_own_clocks(
    sessions: tuple[Recording, Recording],
) -> None:
    alone = [average(r).circumstances(r.rig).time_s for r in sessions]
    at = average(together(sessions)).circumstances(RIG)
    assert alone[0] is not None
    assert alone[1] is not None
    assert at.time_s is not None
    assert at.running_s is not None
    assert np.all(np.diff(at.time_s) > 0)
    assert np.allclose(at.running_s, np.concatenate(alone), atol=1e-6)


def test_motion_is_read_on_one_clock(sessions: tuple[Recording, Recording]) -> None:
    both = together(sessions)
    table, _ = with_motion(both, average(both))
    alone = [with_motion(r, average(r))[0] for r in sessions]
    quiet = np.median([np.median(t.sigma[len(t.windows) // 2 :]) for t in alone])
    moving = table.sigma[len(average(both).counts) :]
    assert len(moving) > 10
    assert np.median(moving) < 2.0 * quiet


def test_a_joint_that_turned_over_between_sessions_is_unwrapped_by_itself(
    sessions: tuple[Recording, Recording],
) -> None:
    first, second = sessions
    period = 400000
    turned = {
        name: replace(r, raw=(r.raw + period // 2 + 1000) % period if name == "q1" else r.raw)
        for name, r in second.readings.items()
    }
    expected = average(replace(second, readings=turned)).counts
    both = average(together([first, replace(second, readings=turned)])).counts
    assert np.allclose(both[-len(expected) :], expected)


def test_another_rig_is_refused(sessions: tuple[Recording, Recording], tmp_path: Path) -> None:
    text, source = rig_text("shoulder")
    simulate(parse_rig(text, source), text, tmp_path / "other.mcap", poses=4)
    with pytest.raises(NotEnoughData, match=r"rig 'shoulder'.*one and the same rig"):
        together([sessions[0], read_recording(tmp_path / "other.mcap")])
    changed = sessions[1].rig.model_copy(update={"gravity": None})
    with pytest.raises(NotEnoughData, match=r"differs from that of .* in: gravity"):
        together([sessions[0], replace(sessions[1], rig=changed)])


def test_another_plan_draws_other_noise_in_the_same_nature(
    sessions: tuple[Recording, Recording], tmp_path: Path
) -> None:
    again = simulate(RIG, TEXT, tmp_path / "again.mcap", seed=4, plan=OTHER_PLAN)
    assert again.parameters == simulate(RIG, TEXT, tmp_path / "own.mcap", seed=4).parameters
    one, two = sessions[1].readings["q6"], read_recording(tmp_path / "again.mcap").readings["q6"]
    assert np.array_equal(one.raw, two.raw)
    tables = [average(r) for r in (sessions[0], sessions[1])]
    assert not np.array_equal(tables[0].noise, tables[1].noise)
