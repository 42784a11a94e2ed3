"""The blind benchmark: cases that do not change, strengths that hold, scores that count right, a run that resumes."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import Result

from loopcal.blind import run as running
from loopcal.blind.answering import answer
from loopcal.blind.grid import MECHANISMS, STRENGTHS, Case, cases, rig_of, short_cases
from loopcal.blind.making import make
from loopcal.blind.page import CONFUSION, CURVES, JSON, PAGE, confusion, write_page
from loopcal.blind.run import ANSWERS, SEALED, read
from loopcal.blind.score import Outcome, Rate, scores
from loopcal.blind.strength import Bench
from recordings.reader import read_recording
from recordings.rig import parse_rig
from sim_devices.simulate import simulate
from solver.gap.analysis import first_fit
from solver.samples import average
from solver.solve import solve
from tests.child_process import child_process


def case_of(kind: str, *names: str, strength: float = 225.0, mechanism: str = "shoulder") -> Case:
    return Case(mechanism, kind, names, strength, "clean", 0, 7)


def effect(label: str, size: float = 1.0, **more: Any) -> dict[str, Any]:
    name, _, where = label.partition("@")
    return {"name": name, "where": where, "size": size, "unit": "m", **more}


def hidden(label: str, strength: float = 225.0, nearest: float = 100.0) -> dict[str, Any]:
    return effect(
        label,
        strength=strength,
        retained=0.3,
        nearest="",
        nearest_leaves=nearest,
        own_leaves=0.0,
    )


def outcome(
    truths: list[dict[str, Any]],
    *groups: tuple[str, ...],
    kind: str = "single",
    verdict: str | None = None,
    noise: str = "clean",
) -> Outcome:
    said = [
        effect(
            first, standard_error=0.1, could_also_be=[effect(r, standard_error=0.1) for r in rest]
        )
        for first, *rest in groups
    ]
    named = "ambiguous" if any(len(group) > 1 for group in groups) else "named"
    return Outcome(
        {"key": "k", "kind": kind, "noise": noise, "effects": truths, "left_out": None},
        {
            "key": "k",
            "verdict": verdict or (named if groups else "nothing-detectable"),
            "effects": said,
            "gap": {"before": 2.0, "after": 1.02, "closed": 0.97},
            "seconds": 1.0,
            "baselines": {"bic": [group[0] for group in groups]},
        },
    )


def value(name: str, *of: Outcome) -> float | None:
    return next(score.value for score in scores(of) if score.name == name)


def test_the_grid_holds_every_effect_at_every_strength_and_its_cases_never_change() -> None:
    grid = cases(1, runs=1)
    assert {case.mechanism for case in grid} == set(MECHANISMS)
    assert {case.strength for case in grid if case.kind == "single"} == set(STRENGTHS)
    assert {case.kind for case in grid} == {"single", "double", "null", "outsider"}
    assert len({case.key for case in grid}) == len(grid)
    known = {case.key: case.seed for case in grid}
    more = cases(1, runs=2)
    assert known.items() <= {case.key: case.seed for case in more}.items()
    for case in cases(1, runs=1, only="backlash"):
        assert (case.names, case.seed) == (("backlash",), known[case.key])
    assert all(case.seed == known[case.key] for case in short_cases(1))
    assert {case.seed for case in cases(2, runs=1)}.isdisjoint(known.values())


@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_every_mechanism_can_be_calibrated_from_its_own_plan(
    mechanism: str, tmp_path: Path
) -> None:
    text = rig_of(mechanism)
    file = tmp_path / "plain.mcap"
    truth = simulate(parse_rig(text), text, file, seed=4)
    solved = solve(read_recording(file), poses=1000)
    estimate = solved.estimate
    for name, found, error in zip(
        estimate.space.names, estimate.values, estimate.standard_errors, strict=True
    ):
        assert abs(found - truth.parameters[name]) < 5 * error, name


def test_a_made_case_has_the_strength_that_was_wanted(tmp_path: Path) -> None:
    # Strength says by how much the misfit grows: simulate with and without, and compare.
    for name in ("nonlinearity", "crosstalk"):
        file = tmp_path / f"{name}.mcap"
        case = case_of("single", name, strength=900.0)
        sealed = make(case, file)
        (truth,) = sealed.effects
        assert truth.name == name
        assert truth.strength == pytest.approx(900.0, rel=0.06)
        assert 0.0 < truth.retained <= 1.0
        recording = read_recording(file)
        fit = first_fit(recording, average(recording))
        plain = tmp_path / f"{name}-plain.mcap"
        text = rig_of("shoulder")
        simulate(parse_rig(text), text, plain, seed=case.seed)
        without = read_recording(plain)
        bare = first_fit(without, average(without))
        # The misfit grows by lambda, give or take twice the chance product of trace and noise.
        assert abs(fit.rss - bare.rss - 900.0) < 4 * 2 * np.sqrt(900.0)


def test_strength_grows_with_the_square_of_a_small_size(tmp_path: Path) -> None:
    text = rig_of("shoulder")
    bench = Bench(parse_rig(text), text, 3, tmp_path)
    small, large = (bench.trace(f"offset-jump@d2={size}").strength for size in (1e-4, 3e-4))
    assert large / small == pytest.approx(9.0, rel=0.05)
    # An effect that is measured beside another has the trace that it has alone.
    beside = bench.trace("offset-drift@d1=1e-6", ("offset-jump@d2=1e-4",))
    alone = bench.trace("offset-drift@d1=1e-6")
    assert beside.retained == pytest.approx(alone.retained, abs=0.25)


def test_what_no_physical_size_reaches_is_left_out_and_said(tmp_path: Path) -> None:
    file = tmp_path / "none.mcap"
    sealed = make(case_of("single", "thermal-growth", strength=1e9), file)
    assert sealed.left_out is not None
    assert "thermal-growth" in sealed.left_out
    assert not file.exists()


def test_a_recording_tells_nothing_of_what_was_hidden(tmp_path: Path) -> None:
    file = tmp_path / "sealed.mcap"
    sealed = make(case_of("single", "crosstalk"), file)
    recording = read_recording(file)
    told = f"{recording.rig_toml} {recording.session} {recording.marks}"
    assert "crosstalk" not in told
    assert sealed.hide[0] not in told


def test_a_case_is_answered_with_names_and_baselines(tmp_path: Path) -> None:
    file = tmp_path / "case.mcap"
    sealed = make(case_of("single", "offset-jump", strength=900.0), file)
    said = answer(file)
    told = Outcome(asdict(sealed), said)
    assert told.detected
    assert told.found
    assert said["baselines"].keys() == {"bic", "correlation", "lasso", "screening"}
    assert said["baselines"]["bic"][0] == told.truths[0]
    json.dumps(said, allow_nan=False)


def test_rates_have_wilsons_interval() -> None:
    # Wilson 1927; Newcombe, Statist. Med. 17 (1998), table I: 81 of 263, and 0 of 20.
    assert Rate(81, 263).interval == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert Rate(0, 20).interval == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert Rate(29, 29).interval == pytest.approx((0.8830, 1.0), abs=1e-4)
    assert Rate(0, 0).value is None


def test_scores_count_what_they_say() -> None:
    a, b = "gain-error@d1", "nonlinearity@d1"
    right, wrong = outcome([hidden(a)], (a,)), outcome([hidden(a)], (b,))
    group = outcome([hidden(a, nearest=1.0)], (b, a))
    twice = outcome([hidden(a)], (a,), (b,))
    strange = outcome([hidden(a)], verdict="none-of-the-known")
    missed = outcome([hidden(a)])
    name = "right effect and place, strength 225 and above"
    assert value(name, right, wrong, group, twice) == 0.25
    inside = "truth in the set of possible names, strength 225 and above"
    assert value(inside, right, wrong, group, twice) == 0.5
    assert value("a single wrong name", right, wrong, group, missed) == 0.25
    assert value("near-twins reported as a group", right, group) == 1.0
    assert value("detection, strength 64 and above", strange, missed) == 0.5
    assert value("none of the known, falsely said of a known effect", strange, right) == 0.5
    null = [
        outcome([], kind="null"),
        outcome([], (a,), kind="null"),
        outcome([], (a,), kind="null", noise="visits"),
    ]
    assert value("false naming, clean nulls", *null) == 0.5
    assert value("false naming, ugly nulls", *null) == 1.0
    both = outcome([hidden(a), hidden(b)], (b,), (a,), kind="double")
    half = outcome([hidden(a), hidden(b)], (b,), kind="double")
    assert value("both of a double", both, half) == 0.5
    other = outcome([hidden("outsider:creep@d1")], (a,), kind="outsider")
    assert value("none of the known, recognised", other) == 0.0
    assert value("mean size of that set, strength 225 and above", right, group) == 1.5
    failed = outcome([hidden(a)], verdict="error")
    assert not failed.detected
    assert value("analyses that ended in an error", failed, right) == 0.5


def test_a_case_counts_with_the_strength_that_it_has() -> None:
    assert outcome([hidden("a@b", strength=30.0)]).strength == 25.0
    assert outcome([hidden("a@b", strength=1e5)]).strength == 900.0
    assert outcome([hidden("a@b", strength=900.0), hidden("c@d", strength=60.0)]).strength == 64.0
    assert outcome([]).strength == 0.0


def test_the_confusion_matrix_tells_who_is_taken_for_whom() -> None:
    a, b = "gain-error@d1", "nonlinearity@d1"
    rows, columns, counts = confusion(
        [
            outcome([hidden(a)], (a,)),
            outcome([hidden(a)], (b,)),
            outcome([hidden(a)], ("gain-error@d2",)),
            outcome([hidden(a)], (a,), (b,)),
            outcome([hidden(a)]),
        ]
    )
    assert rows == ["gain-error"]
    told = dict(zip(columns, counts[0].tolist(), strict=True))
    assert told == {
        "gain-error": 1,
        "nonlinearity": 1,
        "wrong place": 1,
        "several": 1,
        "none of the known": 0,
        "nothing": 1,
    }


def test_a_run_that_was_ended_goes_on_where_it_was(tmp_path: Path) -> None:
    played: list[str] = []

    def play(scratch: Path, case: Case) -> tuple[dict[str, Any], dict[str, Any] | None]:
        played.append(case.key)
        left_out = "too weak" if case.kind == "single" else None
        return {"key": case.key, "left_out": left_out}, None if left_out else {"verdict": "named"}

    grid = sorted(cases(3, runs=1, mechanisms=("shoulder",)), key=lambda case: case.kind)
    grid = [*grid[:2], *grid[-2:]]
    running.run(grid[1:3], tmp_path, jobs=1, play=play)
    first = (tmp_path / ANSWERS).read_text("utf-8")
    with (tmp_path / SEALED).open("a", encoding="utf-8") as file:
        file.write('{"key": "cut o')
    seen: list[tuple[int, int]] = []
    running.run(
        grid, tmp_path, jobs=1, progress=lambda done, of: seen.append((done, of)), play=play
    )
    assert seen == [(2, 4), (3, 4), (4, 4)]
    assert played == [grid[i].key for i in (1, 2, 0, 3)]
    assert (tmp_path / ANSWERS).read_text("utf-8").startswith(first)
    assert {line["key"] for line in read(tmp_path / SEALED)} == {case.key for case in grid}
    assert len(read(tmp_path / ANSWERS)) == 2


ENDED = """
import os, sys, threading
from pathlib import Path
from loopcal.blind.grid import cases
from loopcal.blind.run import run

def say(line):
    # In one piece: `print` may write the end of a line by itself, and others write here too.
    os.write(sys.stdout.fileno(), f"{line}\\n".encode())

def play(scratch, case):
    if case.key.endswith("/null/clean/0/0"):
        return {"key": case.key, "left_out": "too weak"}, None
    say(f"at work in {scratch}")
    threading.Event().wait()

if __name__ == "__main__":
    nulls = cases(3, runs=1, mechanisms=("shoulder",), only="null")
    nulls = sorted(nulls, key=lambda case: case.key != "shoulder/null/clean/0/0")
    run(nulls, Path(sys.argv[1]), jobs=2, play=play, progress=lambda done, of: say(f"{done} {of}"))
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_is_ended_by_a_signal_ends_its_processes(
    tmp_path: Path, number: signal.Signals
) -> None:
    script, folder = tmp_path / "ended.py", tmp_path / "blind"
    script.write_text(ENDED, "utf-8")
    command = [sys.executable, str(script), str(folder)]
    with child_process(command, stderr=subprocess.DEVNULL) as benchmark:
        assert benchmark.stdout is not None
        told: list[str] = []
        while not (sum("at work" in line for line in told) == 2 and "1 25\n" in told):
            told.append(benchmark.stdout.readline())
            assert told[-1], told
        benchmark.send_signal(number)
        # The output ends when the last process that could write to it has ended.
        rest, _ = benchmark.communicate(timeout=120)
    assert rest == ""
    assert benchmark.returncode == (143 if number == signal.SIGTERM else -number)
    scratch = next(Path(line.split()[-1]) for line in told if "at work" in line)
    assert scratch.exists() == (number == signal.SIGKILL)
    (line,) = read(folder / SEALED)
    assert line["key"] == "shoulder/null/clean/0/0"
    assert (folder / SEALED).read_text("utf-8").endswith("}\n")
    shutil.rmtree(scratch, ignore_errors=True)


def test_a_case_is_the_same_whenever_it_is_played(tmp_path: Path) -> None:
    case = next(c for c in cases(3, runs=1, mechanisms=("shoulder",), only="null"))
    (sealed, said), (again, same) = (running.play(tmp_path, case) for _ in range(2))
    assert {**sealed, "seconds": 0.0} == {**again, "seconds": 0.0}
    assert said is not None
    assert same is not None
    assert {**said, "seconds": 0.0} == {**same, "seconds": 0.0}


def test_the_page_shows_scores_baselines_and_pictures(tmp_path: Path) -> None:
    a, b = "gain-error@d1", "nonlinearity@d1"
    found = [outcome([hidden(a)], (a,)), outcome([hidden(a)], (b, a)), outcome([], kind="null")]
    write_page(found, [{"key": "x", "left_out": "too weak"}], tmp_path)
    assert {JSON, PAGE, CONFUSION, CURVES} <= {path.name for path in tmp_path.iterdir()}
    text = (tmp_path / PAGE).read_text("utf-8")
    assert "3 cases; 1 more could not be made" in text
    assert "| bic |" in text
    document = json.loads((tmp_path / JSON).read_text("utf-8"))
    assert document["effects"]["gain-error"]["within"] == 2


def test_the_command_refuses_what_it_cannot_do(
    loopcal: Callable[..., Result], tmp_path: Path
) -> None:
    outcome = loopcal("blind", "--only", "backlsh", "--out", tmp_path / "a")
    assert outcome.exit_code == 2
    assert "backlash" in outcome.output
    (tmp_path / SEALED).write_text("{}", encoding="utf-8")
    outcome = loopcal("blind", "--out", tmp_path)
    assert outcome.exit_code == 2
    assert "--resume" in outcome.output
