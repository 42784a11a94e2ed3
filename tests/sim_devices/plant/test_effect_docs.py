"""The guide to hidden effects lists what can be hidden, and its example of noise runs."""

from __future__ import annotations

import re
from pathlib import Path

from sim_devices.plant.effects.registry import EFFECT_KINDS, OUTSIDER_KINDS

GUIDE = Path(__file__).parents[3] / "docs" / "howto-hidden-effects.md"
FORMATS = GUIDE.with_name("formats.md")


def test_the_guide_lists_every_effect_once_and_no_other():
    listed = re.findall(r"^\| `([a-z:-]+)` \|", GUIDE.read_text("utf-8"), flags=re.MULTILINE)
    assert listed == [*EFFECT_KINDS, *OUTSIDER_KINDS]


def test_nature_knows_the_effects_of_the_format():
    text = FORMATS.read_text("utf-8")
    section = text[text.index("## `[[effect]]`") : text.index("## `[[port]]`")]
    listed = re.findall(r"^\| `([a-z-]+)` \|", section, flags=re.MULTILINE)
    assert [name for name in listed if name != "name"] == list(EFFECT_KINDS)
