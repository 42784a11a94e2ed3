"""A solve in a few lines, for a terminal: one line of verdict, and a row a parameter."""

from __future__ import annotations

from dataclasses import dataclass

from solver.report.comparison import compare
from solver.report.notation import decimals_for, fixed, signed
from solver.report.verdict import Grade, verdict
from solver.solve import Solution


@dataclass(frozen=True, slots=True)
class Summary:
    """A solve as text; how it is set and coloured is up to who shows it.

    Attributes:
        grade: "good", "caution" or "bad".
        verdict: one sentence, with the remedy where there is no result.
        facts: pairs of a label and what it says.
        columns: headings of ``rows``.
        rows: a row an identified parameter, in rig order: name, estimate, standard error,
            change from nominal, unit.
    """

    grade: Grade
    verdict: str
    facts: tuple[tuple[str, str], ...]
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


COLUMNS = ("parameter", "estimate", "± SE", "change", "unit")


def summary(solution: Solution) -> Summary:
    """``solution`` in a few lines."""
    rows = compare(solution)
    found = verdict(solution, rows)
    out = []
    for row in rows:
        digits = decimals_for(row.estimate.standard_error)
        out.append(
            (
                row.name,
                fixed(row.estimate.value, digits),
                fixed(row.estimate.standard_error, digits),
                signed(row.change, digits),
                row.unit.name,
            )
        )
    remedy = f" {found.remedy[:1].upper()}{found.remedy[1:]}." if found.remedy else ""
    return Summary(
        grade=found.grade,
        verdict=found.headline + remedy,
        facts=tuple((fact.label, f"{fact.value} ({fact.note})") for fact in found.facts),
        columns=COLUMNS,
        rows=tuple(out),
    )
