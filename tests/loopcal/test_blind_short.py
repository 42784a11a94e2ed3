"""The short blind benchmark, with limits: what was reached when they were set, less a margin."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result


@pytest.mark.timeout(800)  # a minute and a half on two idle cores
def test_the_short_benchmark_reaches_its_limits(
    loopcal: Callable[..., Result], tmp_path: Path
) -> None:
    folder = tmp_path / "blind"
    outcome = loopcal("blind", "--short", "--out", folder, "--jobs", 2)
    assert outcome.exit_code in (0, 1), outcome.output
    document = json.loads((folder / "scores.json").read_text("utf-8"))
    value = {score["name"]: score["value"] for score in document["scores"]}
    assert document["cases"] + len(document["left_out"]) == 18
    assert not document["left_out"]
    assert value["analyses that ended in an error"] == 0.0
    # Reached when frozen: detection 10 of 10, right 8, in the set 9, no false and no single wrong name.
    assert value["detection, strength 64 and above"] >= 0.9
    assert value["right effect and place, strength 225 and above"] >= 0.6
    assert value["truth in the set of possible names, strength 225 and above"] >= 0.7
    assert value["a single wrong name"] <= 0.1
    assert value["none of the known, falsely said of a known effect"] <= 0.2
    assert value["false naming, clean nulls"] == 0.0
    assert value["false naming, ugly nulls"] <= 0.2
    assert value["held-out gap closed, median, strength 225 and above"] >= 0.85
