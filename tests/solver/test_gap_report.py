"""The report of a gap analysis, and its words, at every kind of answer."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from recordings.reader import Recording, read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import analyse
from solver.gap.result import Gap, Rival, Verdict, gap_json
from solver.gap.unknown import Unknown
from solver.report.gap_report import render_gap, write_gap_report
from solver.report.gap_words import advice, amount, headline, listed, odds, share
from solver.samples import Rejected
from tests.solver.test_report import Page


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Gap, Recording]:
    path = tmp_path_factory.mktemp("gap") / "bent.mcap"
    hidden = ("nonlinearity@d1=2%",)
    simulate(load_rig("shoulder"), rig_text("shoulder")[0], path, poses=40, seed=5, hide=hidden)
    recording = read_recording(path)
    return analyse(recording), recording


def kinds(gap: Gap) -> dict[str, Gap]:
    """The same analysis, had it ended otherwise."""
    rival = Rival("eccentricity", "d1", -2.0, 6e-4, 2e-5, "m")
    ambiguous = replace(gap.effects[0], could_also_be=(rival,))
    bare = replace(gap, effects=(), after=gap.before, disagreement_after=gap.disagreement_before)
    return {
        "named": gap,
        "ambiguous": replace(gap, verdict=Verdict.AMBIGUOUS, effects=(ambiguous,)),
        "nothing": replace(bare, verdict=Verdict.NOTHING),
        "unknown": replace(bare, verdict=Verdict.UNKNOWN),
        "few": replace(gap, held_out=None, provisional=True),
    }


@pytest.mark.parametrize("kind", ["ambiguous", "unknown"])
def test_every_answer_has_a_whole_page(analysed: tuple[Gap, Recording], kind: str) -> None:
    gap, recording = kinds(analysed[0])[kind], analysed[1]
    page = Page(render_gap(gap, recording=recording))
    figures = {figure["id"] for figure in page.all("figure")}
    expected = {"disagreement-before", "pose-maps"}
    expected |= {"disagreement-after"} if gap.effects else set()
    expected |= {"held-out"} if gap.held_out is not None else set()
    assert figures == expected
    assert ("What is missing" in page.text) == bool(gap.effects)
    assert headline(gap).replace("-", "−")[:30] in page.text.replace("-", "−")
    identifiers = [a["id"] for _, a in page.elements if "id" in a]
    assert len(identifiers) == len(set(identifiers))
    assert not [a for _, a in page.elements if str(a.get("src", "")).startswith("http")]
    for each in gap.untested:
        assert each.reason in page.text


def test_a_page_without_a_name_shows_the_strangest_pattern(
    analysed: tuple[Gap, Recording],
) -> None:
    gap = kinds(analysed[0])["unknown"]
    swing = next(p for p in gap.unknown.patterns if p.over == "swing")
    strange = replace(gap, unknown=Unknown((swing, *gap.unknown.patterns), 0.002))
    page = Page(render_gap(strange, recording=analysed[1]))
    assert "pattern" in {figure["id"] for figure in page.all("figure")}
    assert "as a swing up and down" in page.text
    assert "the picture below" in page.text
    assert "--report PAGE" not in page.text.replace("--report PAGE.html", "")
    assert "--report PAGE" in " ".join(advice(strange))
    answer = gap_json(strange)
    assert answer["patterns"]["p"] == 0.002
    assert answer["patterns"]["strangest"][0]["over"] == "swing"


def test_what_held_out_poses_do_not_bear_out_is_not_recommended(
    analysed: tuple[Gap, Recording],
) -> None:
    gap, recording = analysed
    assert gap.held_out is not None
    assert not gap.doubtful
    rejected = tuple(Rejected(w, "still moving: d1") for w in gap.table.windows[:20])
    doubtful = replace(
        gap,
        held_out=replace(gap.held_out, after=1.6, after_error=0.1),
        table=replace(gap.table, rejected=rejected),
    )
    assert headline(doubtful).endswith("Poses that took no part do not bear it out.")
    assert "--rig-out" not in " ".join(advice(doubtful))
    assert "Do not build on the name yet" in " ".join(advice(doubtful))
    page = Page(render_gap(doubtful, recording=recording))
    assert "Caution. 20 of " in page.text
    assert "depends on which poses are used" in page.text


def test_what_counts_as_noise_is_said_where_the_gap_does_not_show_it(
    analysed: tuple[Gap, Recording],
) -> None:
    gap = kinds(analysed[0])["unknown"]
    assert gap.held_out is not None
    closed = replace(
        gap,
        held_out=replace(gap.held_out, before=1.01, before_error=0.05),
        floor_before=replace(gap.floor_before, variance=25.0, revisited=10),
    )
    (told,) = (line for line in closed.cautions if "counts as noise" in line)
    assert "differ 5.0 times" in told
    assert "gap of 1.01" in told
    assert not [line for line in gap.cautions if "counts as noise" in line]


def test_a_page_of_few_poses_is_written_the_same_every_time(
    analysed: tuple[Gap, Recording], tmp_path: Path
) -> None:
    gap = replace(kinds(analysed[0])["nothing"], held_out=None, provisional=True)
    path = tmp_path / "gap.html"
    write_gap_report(gap, path, recording=analysed[1], next_poses="<next>.toml")
    html = path.read_text("utf-8")
    assert "--plan &lt;next&gt;.toml" in html
    assert "<next>" not in html
    assert "too few to hold any out" in html
    assert html == render_gap(gap, recording=analysed[1], next_poses="<next>.toml")


def test_the_headline_says_what_where_and_how_big(analysed: tuple[Gap, Recording]) -> None:
    told = {kind: headline(gap) for kind, gap in kinds(analysed[0]).items()}
    assert told["named"].startswith("Missing: nonlinearity of d1, 0.")
    assert told["ambiguous"].endswith("This recording cannot tell it from eccentricity of d1.")
    assert told["nothing"].startswith("Nothing detectable is missing")
    assert "none of the effects that are known" in told["unknown"]
    assert told["few"].endswith("Provisional.")


def test_advice_fits_the_answer(analysed: tuple[Gap, Recording]) -> None:
    told = {kind: " ".join(advice(gap)) for kind, gap in kinds(analysed[0]).items()}
    assert "--rig-out" in told["named"]
    assert "tell the rivals apart" in told["ambiguous"]
    assert "--rig-out" not in told["unknown"] + told["nothing"]
    assert "visited three times" in told["few"]
    assert "ten or more distinct ones" in told["few"]


def test_numbers_are_written_for_people() -> None:
    assert amount(5.668e-4, "m", 5.7e-6) == "0.5668 ± 0.0057 mm"
    assert amount(0.0959, "deg", 0.0012) == "95.9 ± 1.2 mdeg"
    assert amount(0.0123, "1") == "1.23 %"
    assert amount(2.0, "bits", 0.5) == "2.00 ± 0.50 bits"
    assert share(0.99999) == "more than 99.9 %"
    assert share(1.0004) == "100.0 %"
    assert listed(map(str, range(10))) == "0, 1, 2, 3, 4, 5, 6, 7 and 2 more"


def test_odds_never_grow_as_evidence_falls() -> None:
    assert odds(-0.2) == "about as likely"
    assert "1 : 7" in odds(-2.0)
    assert "less than 1 : 1000" in odds(-50.0)


def test_json_has_null_for_what_is_no_number(analysed: tuple[Gap, Recording]) -> None:
    gap = analysed[0]
    endless = replace(gap, limits=(replace(gap.limits[0], size=float("inf")),))
    answer = json.loads(json.dumps(gap_json(endless, "plan.toml"), allow_nan=False))
    assert answer["detection_limits"][0]["size"] is None
    assert answer["next_poses"] == "plan.toml"
