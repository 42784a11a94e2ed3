"""Near-twins told apart: poses are proposed, written as a plan, played, and analysed together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from loopcal.next_poses import next_text
from recordings.reader import Recording, read_recording
from recordings.rig import Rig, load_plan, parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.errors import MechanismError
from solver.gap.analysis import first_fit
from solver.gap.elsewise import elsewise
from solver.gap.next_poses import NextPoses, propose
from solver.gap.search import Search, search
from solver.gap.together import together
from solver.gap.trace import traces
from solver.samples import average

Run = Callable[..., Result]

HIDDEN = "gain-error@q2"


def careful() -> tuple[Rig, str]:
    """The arm with a first session in a small part of its reach."""
    lines = rig_text("arm")[0].splitlines()
    changed = {
        "corners_deg": "corners_deg = [[52, -30], [70, -30], [70, 5], [52, 5]]",
        "poses": "poses = 24",
    }
    text = "\n".join(changed.get(line.split(" ")[0], line) for line in lines)
    return parse_rig(text, "arm"), text


def searched(*sessions: Recording) -> Search:
    joined = together(sessions)
    return search(first_fit(joined, average(joined)), np.random.default_rng(1))


def names(found: Search) -> set[str]:
    return {p.effect.label for named in found.named for p in (named.best, *named.rivals)}


@dataclass(frozen=True, repr=False)
class Case:
    folder: Path
    first: Recording
    found: Search
    proposal: NextPoses


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("twins")
    rig, text = careful()
    (folder / "rig.toml").write_text(text)
    simulate(rig, text, folder / "first.mcap", seed=3, hide=[f"{HIDDEN}=0.08%"])
    first = read_recording(folder / "first.mcap")
    found = searched(first)
    return Case(folder, first, found, propose(found, average(first)))


def test_the_first_session_leaves_several_names(case: Case) -> None:
    assert HIDDEN in names(case.found)
    assert len(names(case.found)) > 2


def test_separation_is_what_a_rival_cannot_take_up(case: Case) -> None:
    contest = case.proposal.contests[0]
    rival = contest.others[0][0]
    contest = replace(contest, others=((rival,),))
    fit = contest.fit
    own = fit.model.columns[-1]
    parameters = np.delete(fit.jacobian, np.searchsorted(fit.space.identified, own), axis=1)
    trace, does = traces(fit, [rival, contest.effect])
    known = np.zeros((len(fit.jacobian) - len(trace), trace.shape[1] + 1))
    rows = np.vstack([np.hstack([trace, (does @ contest.coefficients)[:, None]]), known])
    X = np.hstack([parameters, rows[:, :-1]])
    scale = np.linalg.norm(X, axis=0)
    left = rows[:, -1] - (X / scale) @ np.linalg.lstsq(X / scale, rows[:, -1], rcond=1e-10)[0]
    expected = float(left @ left) / contest.noise
    assert contest.separation(contest.captured())[0] == pytest.approx(expected, rel=0.02, abs=0.05)


def test_the_plan_is_within_reach_and_tells_more_than_random_poses(case: Case) -> None:
    plan, rig = case.proposal.plan, careful()[0]
    assert plan is not None
    assert 1 <= len(plan.targets or ()) <= 6
    assert plan.revisit.poses == len(plan.targets or ())
    assert plan.revisit.visits > 1
    for name, column in zip(plan.drives, np.array(plan.targets).T, strict=True):
        joint = next(j for j in rig.mechanism.joints if j.name == name)
        assert joint.limits.low < column.min() <= column.max() < joint.limits.high
    counted = [p for p in case.proposal.pairs if p.separable]
    assert counted
    assert min(p.proposed - p.random for p in counted if p.chance < 0.999) > 0
    assert all(p.proposed > p.now for p in counted)


def test_what_the_poses_can_rule_out_is_ruled_out(loopcal: Run, case: Case) -> None:
    rig, _ = careful()
    assert case.proposal.plan is not None
    (case.folder / "plan.toml").write_text(next_text(rig, case.proposal))
    plan = load_plan(case.folder / "plan.toml")
    assert np.allclose(plan.targets, case.proposal.plan.targets, atol=1e-5)
    hidden = ("--seed", "3", "--hide", f"{HIDDEN}=0.08%")
    outcome = loopcal(
        "simulate",
        case.folder / "rig.toml",
        "-o",
        case.folder / "more.mcap",
        *hidden,
        "--plan",
        case.folder / "plan.toml",
    )
    assert outcome.exit_code == 0, outcome.stderr
    after = searched(case.first, read_recording(case.folder / "more.mcap"))
    assert after.complete
    assert HIDDEN in names(after)
    certain = {
        p.other
        for p in case.proposal.pairs
        if p.effect == HIDDEN and p.separable and p.chance > 0.99
    }
    assert certain
    assert not certain & names(after)


def test_what_no_pose_tells_apart_is_said(case: Case) -> None:
    hopeless = {frozenset((p.effect, p.other)) for p in case.proposal.pairs if not p.separable}
    told = {frozenset((e.effect, e.other)): e for e in elsewise(case.proposal)}
    assert hopeless
    assert hopeless <= set(told)
    assert all("feasible" in told[pair].text for pair in hopeless)
    together = case.proposal.twins
    assert {name for group in together for name in group} == {n for pair in hopeless for n in pair}
    assert all(any(pair <= set(group) for group in together) for pair in hopeless)
    written = next_text(careful()[0], case.proposal)
    assert f"# No reachable pose tells apart: {', '.join(together[0])}." in written


def test_a_rival_counts_in_the_form_that_comes_nearest(case: Case) -> None:
    (contest,) = (c for c in case.proposal.contests if c.effect.label == HIDDEN)
    number = contest.rivals.index("eccentricity@q2")
    other = next(i for i in range(len(contest.others)) if len(contest.others[i]) > 1)
    each = [
        replace(contest, others=((form,),)).separation(
            replace(contest, others=((form,),)).captured()
        )[0]
        for form in contest.others[other]
    ]
    found = contest.separation(contest.captured())
    assert found[other] == pytest.approx(min(each), rel=1e-6, abs=1e-6)
    assert len(contest.others[number]) == 1


def test_an_effect_that_is_suspected_can_be_planned_for(case: Case) -> None:
    table = average(case.first)
    proposal = propose(case.found, table, wanted="backlash@q5", most=3)
    (pair,) = proposal.pairs
    assert (pair.effect, pair.other) == ("backlash@q5", "")
    assert pair.proposed > pair.now
    assert len(proposal.coordinates) == 3
    assert np.ptp(proposal.visited.at.approach[:, 4]) == 2.0
    with pytest.raises(MechanismError, match=r"'nonsense@q2' is no effect .* these are: "):
        propose(case.found, table, wanted="nonsense@q2")


def test_without_rivals_nothing_is_planned(case: Case) -> None:
    alone = replace(case.found, named=())
    with pytest.raises(MechanismError, match="no rivals are left"):
        propose(alone, average(case.first))


def test_recordings_of_two_rigs_are_refused(loopcal: Run, case: Case, tmp_path: Path) -> None:
    assert loopcal("simulate", "shoulder", "-o", tmp_path / "s.mcap").exit_code == 0
    outcome = loopcal("gap", case.first.path, tmp_path / "s.mcap")
    assert outcome.exit_code == 2
    assert "cannot be analysed together" in " ".join(outcome.stderr.split())


def test_plans_are_not_overwritten_nor_asked_for_in_vain(
    loopcal: Run, case: Case, tmp_path: Path
) -> None:
    (tmp_path / "plan.toml").write_text("mine")
    outcome = loopcal("gap", case.first.path, "--next", tmp_path / "plan.toml")
    assert outcome.exit_code == 2
    assert (tmp_path / "plan.toml").read_text() == "mine"
    outcome = loopcal("gap", case.first.path, "--next-for", "backlash@q5")
    assert outcome.exit_code == 2
    assert "--next" in outcome.stderr
