"""Near-twins told apart by proposed poses, and by as many random ones.

An arm is first recorded with care: thirty poses in a small part of its reach, so that effects of
one joint look alike. An effect is hidden at a strength (lambda) at which it is surely seen. Where
the analysis leaves several names, up to six poses are proposed, captured, and everything is
analysed together; so are as many random poses of the same reach, with the same revisits.

Some names no reachable pose tells from the true one: twins, which the proposal names as such. A group
without any can be resolved; of one with twins, all the others can be ruled out.

Run: ``python benchmarks/next_poses.py [--seeds 2] [--jobs 2] [--json FILE]``.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from recordings.reader import Recording, read_recording
from recordings.rig import Plan, Rig, parse_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import first_fit
from solver.gap.next_poses import NextPoses, propose
from solver.gap.search import Look, Search, look, search
from solver.gap.together import together
from solver.samples import average

STRENGTH = 225.0
_FIRST_CORNERS = "[[52, -30], [70, -30], [70, 5], [52, 5]]"
_FIRST_POSES = 30
_SURE = 0.95
_MOST = 2.0  # times the stated size: what nature still takes

CASES = {
    "gain-error@q2": "0.1%",
    "axis-offset@joint3": "5e-4",
    "link-geometry@joint2.alpha": "0.1",
    "gain-error@q6": "1%",
    "eccentricity@q6": "0.2",
    "nonlinearity@q6": "1%",
    "joint-compliance@joint6": "0.1",
    "crosstalk@q6<-q7": "1%",
    "backlash@q5": "0.05",
    "gain-error@q5": "0.1%",
    "link-geometry@joint3.s": "5e-4",
    "eccentricity@q2": "0.1",
}
"""Effects with a size from which the one of the wanted strength is found."""


@dataclass(frozen=True)
class Outcome:
    """One case.

    Attributes:
        case: the effect, and the seed of nature.
        strength: lambda in the first session.
        first: names left after it, likeliest first, with their posterior.
        poses: how many were proposed; 0 where none tells any pair apart.
        chance: that they decide, as predicted.
        separable: names other than the true one that poses can tell from it.
        proposed, random: names left after the further poses, with their posterior.
        random_poses: how many random poses would separate the worst pair as well, as predicted.
    """

    case: str
    strength: float
    first: dict[str, float]
    poses: int
    chance: float
    separable: tuple[str, ...]
    proposed: dict[str, float]
    random: dict[str, float]
    random_poses: float

    @property
    def label(self) -> str:
        """Of the effect at work."""
        return self.case.split(" ")[0]

    @property
    def twins(self) -> tuple[str, ...]:
        """Names that no reachable pose tells from the true one."""
        return tuple(n for n in self.first if n not in (self.label, *self.separable))

    def resolved(self, left: dict[str, float]) -> bool:
        """Whether the true name has at least 95 % of what the names left have."""
        return left.get(self.label, 0.0) >= _SURE

    def ruled_out(self, left: dict[str, float]) -> bool:
        """Whether the true name is left, and nothing that poses can tell from it."""
        return self.label in left and not set(self.separable) & set(left)


def _first_rig() -> tuple[Rig, str]:
    text = re.sub(r"corners_deg = .*", f"corners_deg = {_FIRST_CORNERS}", rig_text("arm")[0])
    text = re.sub(r"(?m)^poses = \d+", f"poses = {_FIRST_POSES}", text)
    return parse_rig(text, "arm"), text


def _recorded(path: Path, seed: int, hidden: str, plan: Plan | None = None) -> Recording:
    rig, text = _first_rig()
    simulate(rig, text, path, seed=seed, hide=[hidden], plan=plan)
    return read_recording(path)


def _searched(sessions: Sequence[Recording]) -> Search:
    joined = together(sessions)
    return search(first_fit(joined, average(joined)), np.random.default_rng(1))


def _strength(seen: Look, label: str) -> float:
    labels = [c.label for c in seen.candidates]
    if label not in labels:
        raise SystemExit(f"'{label}' cannot be looked for in the first session; take it out")
    number = labels.index(label)
    noise = max((seen.fit.rss - seen.statistic(number)) / max(seen.fit.freedoms - 1, 1), 1e-12)
    return seen.statistic(number) / noise


def _scaled(size: str, by: float) -> str:
    number, unit = (size[:-1], "%") if size.endswith("%") else (size, "")
    return f"{float(number) * by:.6g}{unit}"


def _left(found: Search) -> dict[str, float]:
    """Names that are left and their posterior; all zero where none is enough."""
    if not found.named or not found.complete:
        return {}
    every = (found.named[0].best, *found.named[0].rivals)
    evidence = np.array([p.log_evidence for p in every])
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    return {p.effect.label: float(w) for p, w in zip(every, weights, strict=True)}


def _worst(proposal: NextPoses, label: str) -> float:
    numbers = [p.random_poses for p in proposal.pairs if p.effect == label and p.separable]
    return max(numbers, default=0.0)


def play(case: tuple[str, int]) -> Outcome | None:
    """One case; None where the first session leaves one name only, or none."""
    label, seed = case
    with tempfile.TemporaryDirectory() as folder:
        trial = _recorded(Path(folder) / "trial.mcap", seed, f"{label}={CASES[label]}")
        seen = look(first_fit(trial, average(trial)), np.random.default_rng(1))
        found = _strength(seen, label)
        by = min(float(np.sqrt(STRENGTH / max(found, 1e-12))), _MOST)
        size = _scaled(CASES[label], by)
        first = _recorded(Path(folder) / "first.mcap", seed, f"{label}={size}")
        before = _searched([first])
        left = _left(before)
        if len(left) < 2:
            return None
        strength = _strength(before.before, label)
        proposal = propose(before, average(first))
        separable = tuple(p.other for p in proposal.pairs if p.effect == label and p.separable)
        name = f"{label} {seed}"
        if proposal.plan is None:
            return Outcome(name, strength, left, 0, 0.0, (), {}, {}, np.inf)
        rng = np.random.default_rng(seed)
        poses = len(proposal.coordinates)
        drawn = rng.choice(len(proposal.reach.coordinates), poses, replace=False)
        after = [
            _left(
                _searched(
                    [first, _recorded(Path(folder) / f"{n}.mcap", seed, f"{label}={size}", plan)]
                )
            )
            for n, plan in (
                ("proposed", proposal.plan),
                ("random", proposal.reach.plan(drawn.tolist())),
            )
        ]
        return Outcome(
            name,
            strength,
            left,
            poses,
            proposal.chance,
            separable,
            after[0],
            after[1],
            _worst(proposal, label),
        )


def main() -> None:
    """Play all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    every = [(label, seed) for seed in range(1, arguments.seeds + 1) for label in CASES]
    outcomes: list[Outcome] = []
    single = 0
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for outcome in pool.map(play, every):
            if outcome is None:
                single += 1
                continue
            outcomes.append(outcome)
            told = {k: round(v, 3) for k, v in outcome.first.items()}
            print(f"{outcome.case} (lambda {outcome.strength:.0f}): {told}", flush=True)
            print(f"   twins: {', '.join(outcome.twins) or 'none'}", flush=True)
            print(f"   poses {outcome.poses}, chance {outcome.chance:.2f}", end="")
            print(f", as good as {outcome.random_poses:.0f} random ones", flush=True)
            for which in ("proposed", "random"):
                told = {k: round(v, 3) for k, v in getattr(outcome, which).items()}
                print(f"   {which}: {told}", flush=True)
    apart = [o for o in outcomes if not o.twins and not o.resolved(o.first)]
    twinned = [o for o in outcomes if o.twins]
    some = [o for o in twinned if o.separable]
    print(
        f"\n{len(every)} first sessions, {single} with one name or none, {len(outcomes)} ambiguous"
    )
    print(f"groups that reachable poses could resolve: {len(apart)}; with twins: {len(twinned)}")
    for which in ("proposed", "random"):
        sure = sum(o.resolved(getattr(o, which)) for o in apart)
        out = sum(o.ruled_out(getattr(o, which)) for o in some)
        print(
            f"{which}: resolved {sure} of {len(apart)}; of {len(some)} with twins and others, ",
            end="",
        )
        print(f"the true name and its twins alone left in {out}")
    numbers = [o.random_poses for o in outcomes if o.poses]
    if numbers:
        print(f"random poses for the same separation, median: {np.median(numbers):.0f}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(o) for o in outcomes], indent=1))


if __name__ == "__main__":
    main()
