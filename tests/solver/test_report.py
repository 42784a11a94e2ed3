"""The HTML report: complete, self-contained, escaped, the same every time, written whole or not at all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from recordings.events import Fault, LedgerEntry
from recordings.reader import Recording
from recordings.session import Session
from solver.estimate.trust_region import Status
from solver.report.report import ReportError, render, write_report
from tests.solver.synthetic import solution, truth_shown

_VOID = {"meta", "br", "path", "use", "rect", "line", "circle", "polygon"}
_FIGURES = {"changes", "residuals", "selected", "sensitivity", "singular-values"}


class Page(HTMLParser):
    """What the tests need to know of a page: elements, identifiers, text, and whether tags match."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in _VOID or self.get_starttag_text() is None:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@cache
def html_of(name: str) -> str:
    return render(solution(name), truth=truth_shown(name))


@cache
def page_of(name: str) -> Page:
    return Page(html_of(name))


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_shows_every_parameter_channel_and_method(name: str) -> None:
    solved, page = solution(name), page_of(name)
    for parameter in solved.estimate.space.table:
        assert parameter.name in page.text
    for channel in solved.table.channels:
        assert channel in page.text
    for method in (solved.estimate, *solved.beside):
        assert f"By {method.method}" in page.text or method is solved.estimate
    assert "Truth" in page.text


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_loads_nothing_from_anywhere(name: str) -> None:
    page = page_of(name)
    for tag, attributes in page.elements:
        assert tag not in {"script", "link", "img", "image", "iframe", "object", "embed", "base"}
        for key in ("src", "href", "xlink:href", "srcset", "data", "poster"):
            assert (attributes.get(key) or "#").startswith("#"), (tag, attributes)
    html = html_of(name)
    assert "http://" not in html
    assert "https://" not in html
    assert "@import" not in html
    assert "url(" not in html.replace("url(#", "")


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_references_inside_the_page_lead_somewhere(name: str) -> None:
    page = page_of(name)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    targets = [str(a["href"]).removeprefix("#") for _, a in page.elements if "href" in a]
    targets += [
        str(a[k]) for _, a in page.elements for k in a if k.startswith("aria-") and k.endswith("by")
    ]
    assert targets
    assert set(targets) <= set(ids)


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_every_figure_is_there_with_words_for_those_who_cannot_see_it(name: str) -> None:
    page = page_of(name)
    figures = {attributes["id"] for attributes in page.all("figure")}
    assert figures == _FIGURES | ({"closures"} if name == "arm" else set())
    drawings = page.all("svg")
    assert len(drawings) == len(figures) == len(page.all("figcaption"))
    for drawing in drawings:
        assert drawing["role"] == "img"
        assert len(drawing["aria-label"] or "") > 40


def test_colours_come_from_the_page_so_that_dark_pages_can_be_read() -> None:
    html = html_of("shoulder")
    drawings = html[html.index("<body>") :]
    assert "var(--after)" in drawings
    assert "#0" not in drawings.replace("url(#", "").replace('href="#', "").replace("&#0", "")


@pytest.mark.parametrize("name", ["arm", "shoulder"])
def test_same_solution_gives_same_bytes(name: str) -> None:
    assert render(solution(name), truth=truth_shown(name)) == html_of(name)


def test_what_the_rig_and_the_session_say_is_text_and_never_markup(tmp_path: Path) -> None:
    solved = solution("shoulder")
    rig = solved.rig.model_copy(update={"title": "<b>&\"'</b>", "description": "</style><script>"})
    recording = _recording(tmp_path, notes="<script>alert(1)</script>")
    page = Page(render(replace(solved, rig=rig), recording=recording))
    assert not page.all("script")
    assert not page.all("b")
    assert "<b>&\"'</b>" in page.text
    assert "<script>alert(1)</script>" in page.text


def test_recording_adds_session_losses_and_faults(tmp_path: Path) -> None:
    page = Page(render(solution("shoulder"), recording=_recording(tmp_path, notes="after lunch")))
    assert "after lunch" in page.text
    assert "2023-11-14 22:13:20 UTC" in page.text
    assert "d1 120 100 11 5 4 2 0" in page.text
    assert "lvdt-adc: it fell silent" in page.text
    assert f"loopcal solve '{tmp_path}/a session.mcap' -n 50 --method ml" in page.text


def test_rejected_dwells_are_told_with_their_reasons() -> None:
    assert "still moving: q1 moved +9.0 counts" in page_of("arm").text


def test_without_result_the_remedy_comes_first() -> None:
    solved = solution("shoulder")
    stopped = replace(solved.estimate, status=Status.ITERATION_LIMIT)
    page = Page(render(replace(solved, estimate=stopped)))
    assert page.text.index("did not converge") < page.text.index("identify fewer parameters")
    assert "where the search stopped, not a result" in page.text


def test_a_method_without_result_and_poses_that_do_not_close_leave_gaps_not_errors() -> None:
    solved = solution("shoulder")
    other = solved.beside[0]
    nothing = replace(
        other,
        status=Status.DOES_NOT_CLOSE,
        covariance=np.full_like(other.covariance, np.nan),
        jacobian=np.zeros((0, len(other.values))),
        misfit=float("nan"),
    )
    closed = solved.after.closed.copy()
    closed[3:5] = False
    page = Page(
        render(replace(solved, beside=(nothing,), after=replace(solved.after, closed=closed)))
    )
    assert "gave no result to compare with" in page.text
    assert "At 2 poses the loop does not close" in page.text
    assert "nan" not in page.text.split()


def test_all_poses_used() -> None:
    page = Page(render(solution("shoulder", poses=30, use=50)))
    assert "all 30 usable poses were taken" in page.text
    assert "has not been tested on unseen ones" in page.text


def test_writes_the_page(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(solution("shoulder"), path, truth=truth_shown("shoulder"))
    assert path.read_text("utf-8") == html_of("shoulder")
    assert list(tmp_path.iterdir()) == [path]


def test_refuses_to_overwrite_unless_told(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("precious")
    with pytest.raises(ReportError, match="already something at"):
        write_report(solution("shoulder"), path)
    assert path.read_text() == "precious"
    write_report(solution("shoulder"), path, overwrite=True)
    assert path.read_text("utf-8").startswith("<!DOCTYPE html>")


def test_a_folder_that_does_not_exist_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="cannot write the report"):
        write_report(solution("shoulder"), tmp_path / "nowhere" / "report.html")


def _recording(folder: Path, *, notes: str) -> Recording:
    """A recording of the shoulder with everything that a report takes from one."""
    return Recording(
        path=folder / "a session.mcap",
        rig=solution("shoulder").rig,
        rig_toml="",
        session=Session(session_id="s1", start_ns=1_700_000_000_000_000_000, notes=notes),
        readings={},
        dwells=(),
        marks=(),
        faults=(Fault(5, "lvdt-adc", "silent", "it fell silent"),),
        mode_commands=(),
        mode_reports=(),
        clock=(),
        ledger={"d1": LedgerEntry("d1", 9, 120, 100, 11, 5, 4, 2)},
    )
