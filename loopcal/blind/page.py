"""The benchmark's page: table of scores, baselines, confusion matrix, curves; as Markdown, pictures and JSON."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.blind.grid import STRENGTHS, STRONG
from loopcal.blind.score import Outcome, Rate, Score, baseline_scores, scores

JSON = "scores.json"
PAGE = "scores.md"
CONFUSION = "confusion.svg"
CURVES = "curves.svg"

_NOTHING, _UNKNOWN, _SEVERAL = "nothing", "none of the known", "several"
_FEW = 20
_WRONG_PLACE = "wrong place"
_RETAINED = np.array([0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0])


def write_page(
    cases: Sequence[Outcome], left_out: Sequence[dict[str, Any]], folder: Path
) -> tuple[Score, ...]:
    """Write all of it into ``folder``, over what an earlier run wrote there; the table of scores.

    Args:
        cases: made and answered.
        left_out: sealed lines of cases that were not made.
        folder: of the results.
    """
    table = scores(cases)
    document = {
        "schema": 1,
        "cases": len(cases),
        "left_out": [{"key": line["key"], "why": line["left_out"]} for line in left_out],
        "scores": [_plain(score) for score in table],
        "baselines": {
            method: [_plain(score) for score in found]
            for method, found in baseline_scores(cases).items()
        },
        "effects": effect_rates(cases),
    }
    (folder / JSON).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(markdown(cases, left_out), encoding="utf-8")
    _draw(cases, folder)
    return table


def effect_rates(cases: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """By name, of all single cases of `STRONG` and above: how many, and how they ended."""
    out: dict[str, dict[str, int]] = {}
    by_name = defaultdict(list)
    for case in cases:
        if case.kind == "single" and case.strength >= STRONG:
            by_name[case.sealed["effects"][0]["name"]].append(case)
    for name, mine in by_name.items():
        out[name] = {
            "cases": len(mine),
            "detected": sum(c.detected for c in mine),
            "right": sum(c.right for c in mine),
            "within": sum(c.within for c in mine),
            "wrong_alone": sum(c.wrong_alone for c in mine),
            "none_of_the_known": sum(c.verdict == "none-of-the-known" for c in mine),
        }
    return out


def _plain(score: Score) -> dict[str, Any]:
    return {
        "name": score.name,
        "value": score.value,
        "interval": None if score.rate is None else score.rate.interval,
        "hits": None if score.rate is None else score.rate.hits,
        "of": None if score.rate is None else score.rate.of,
        "least": score.least,
        "most": score.most,
        "met": score.met,
    }


def markdown(cases: Sequence[Outcome], left_out: Sequence[dict[str, Any]]) -> str:
    """The page's text."""
    lines = [
        "# Blind benchmark",
        "",
        f"{len(cases)} cases; {len(left_out)} more could not be made: the effect cannot be that strong within "
        "physical sizes, or the mechanism cannot carry out its plan with it.",
        "",
        "| Score | Reached | 95 % interval | Cases | To reach | |",
        "|---|---|---|---|---|---|",
    ]
    for score in scores(cases):
        low, high = (None, None) if score.rate is None else score.rate.interval
        span = "" if low is None or high is None else f"{100 * low:.1f}-{100 * high:.1f} %"
        of = "" if score.rate is None else str(score.rate.of)
        met = {None: "", True: "met", False: "**missed**"}[score.met]
        if met and score.rate is not None and score.rate.of < _FEW:
            met += ", few cases"
        lines.append(f"| {score.name} | {shown(score)} | {span} | {of} | {wanted(score)} | {met} |")
    lines += ["", "## Simpler methods", ""]
    found = baseline_scores(cases)
    if found:
        names = [score.name for score in next(iter(found.values()))]
        lines.append(f"| Method | {' | '.join(names)} |")
        lines.append("|---" * (len(names) + 1) + "|")
        for method, row in found.items():
            lines.append(f"| {method} | {' | '.join(shown(score) for score in row)} |")
    lines += ["", f"## Effects, strength {STRONG:g} and above", ""]
    lines.append(
        "| Effect | Cases | Detected | Right | In the set | Alone and wrong | Called none of the known |"
    )
    lines.append("|---|---|---|---|---|---|---|")
    for name, counts in effect_rates(cases).items():
        lines.append(f"| {name} | {' | '.join(str(count) for count in counts.values())} |")
    lines += [
        "",
        f"![Who is taken for whom]({CONFUSION})",
        "",
        f"![Rates by strength and by the fraction retained]({CURVES})",
        "",
    ]
    return "\n".join(lines)  # fmt: skip


def shown(score: Score) -> str:
    """What was reached, in words."""
    if score.value is None:
        return "no case"
    return f"{100 * score.value:.1f} %" if score.rate is not None else f"{score.value:.3g}"


def wanted(score: Score) -> str:
    """What is to be reached, in words."""

    def told(value: float) -> str:
        return f"{100 * value:.0f} %" if value <= 1.0 else f"{value:g}"

    if score.least is not None and score.most is not None:
        return f"{told(score.least)} to {told(score.most)}"
    if score.least is not None:
        return f"at least {told(score.least)}"
    return "" if score.most is None else f"at most {told(score.most)}"


def _draw(cases: Sequence[Outcome], folder: Path) -> None:
    # Slow to import, and only the end of a run draws; Figure, not pyplot, which holds global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 8.5), layout="constrained")
    axes = figure.subplots()
    rows, columns, counts = confusion(cases)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), rows)
    for (i, j), count in np.ndenumerate(counts):
        if count:
            axes.text(
                j, i, str(count), ha="center", va="center", color="w" if share[i, j] > 0.5 else "k"
            )
    axes.set_xlabel("answered")
    axes.set_ylabel("hidden")
    axes.set_title(f"First name of the answer, strength {STRONG:g} and above")
    figure.savefig(folder / CONFUSION)

    figure = Figure(figsize=(9.5, 4.0), layout="constrained")
    by_strength, by_retained = figure.subplots(1, 2, sharey=True)
    singles = [c for c in cases if c.kind == "single"]
    kinds: tuple[tuple[str, Callable[[Outcome], bool], str], ...] = (
        ("detected", lambda c: c.detected, "o-"),
        ("right effect and place", lambda c: c.right, "s-"),
        ("truth in the set", lambda c: c.within, "^-"),
        ("a single wrong name", lambda c: c.wrong_alone, "x-"),
    )
    for label, hit, style in kinds:
        groups = [[c for c in singles if c.strength == s] for s in STRENGTHS]
        _curve(
            by_strength, STRENGTHS, [Rate(sum(map(hit, g)), len(g)) for g in groups], label, style
        )
        strong = [c for c in singles if c.strength >= STRONG]
        kappa = np.array([c.sealed["effects"][0]["retained"] for c in strong])
        bins = np.clip(np.searchsorted(_RETAINED, kappa) - 1, 0, len(_RETAINED) - 2)
        rates = [
            Rate(
                sum(hit(c) for c, b in zip(strong, bins, strict=True) if b == k),
                int(np.sum(bins == k)),
            )
            for k in range(len(_RETAINED) - 1)
        ]
        middle = np.sqrt(np.maximum(_RETAINED[:-1], 1e-3) * _RETAINED[1:])
        _curve(by_retained, middle, rates, label, style)
    by_strength.set_xlabel("strength λ")
    by_retained.set_xlabel(f"fraction retained κ (λ of {STRONG:g} and above)")
    by_strength.set_ylim(-0.03, 1.03)
    by_strength.legend(fontsize="small", loc="center right")
    figure.savefig(folder / CURVES)


def _curve(
    axes: Any, at: Sequence[float] | Any, rates: Sequence[Rate], label: str, style: str
) -> None:
    x = [a for a, rate in zip(at, rates, strict=True) if rate.of]
    some = [rate for rate in rates if rate.of]
    if not some:
        return
    y = [rate.hits / rate.of for rate in some]
    low = [v - rate.interval[0] for v, rate in zip(y, some, strict=True)]
    high = [rate.interval[1] - v for v, rate in zip(y, some, strict=True)]
    axes.errorbar(x, y, np.maximum([low, high], 0.0), fmt=style, capsize=2, label=label, ms=4)
    axes.set_xscale("log")


def confusion(cases: Sequence[Outcome]) -> tuple[list[str], list[str], Any]:
    """Hidden names, answered names, and how often one was answered for the other; strong single cases."""
    strong = [c for c in cases if c.kind in ("single", "outsider") and c.strength >= STRONG]
    rows = list(dict.fromkeys(c.sealed["effects"][0]["name"] for c in strong))
    answered = [_answered(c) for c in strong]
    others = (_WRONG_PLACE, _SEVERAL, _UNKNOWN, _NOTHING)
    columns = list(dict.fromkeys([*rows, *(a for a in answered if a not in others), *others]))
    counts = np.zeros((len(rows), len(columns)), dtype=int)
    for case, said in zip(strong, answered, strict=True):
        counts[rows.index(case.sealed["effects"][0]["name"]), columns.index(said)] += 1
    return rows, columns, counts


def _answered(case: Outcome) -> str:
    if not case.detected:
        return _NOTHING
    if not case.groups:
        return _UNKNOWN
    if len(case.groups) > 1:
        return _SEVERAL
    name = case.named[0].partition("@")[0]
    if name == case.sealed["effects"][0]["name"] and case.named != case.truths:
        return _WRONG_PLACE
    return name
