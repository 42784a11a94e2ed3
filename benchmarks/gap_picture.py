"""The picture of the gap before and after: python benchmarks/gap_picture.py [docs/gap.svg]

Simulates the bundled arm with a bent transducer, analyses the recording, and draws the gap on
poses that took no part in the fit, without and with the effect that was found.
"""

from __future__ import annotations

import re
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from recordings.reader import read_recording
from recordings.rig import load_rig, rig_text
from sim_devices.simulate import simulate
from solver.gap.analysis import analyse
from solver.report.gap_words import gap_closed, headline
from solver.report.pictures.gap_held_out import held_out_picture

HIDDEN = "nonlinearity@q6=2%"
SEED = 1


def main() -> None:
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/gap.svg")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bent.mcap"
        simulate(load_rig("arm"), rig_text("arm")[0], path, seed=SEED, hide=(HIDDEN,))
        gap = analyse(read_recording(path), seed=SEED)
    print(headline(gap))
    print(gap_closed(gap))
    if gap.held_out is None:
        raise SystemExit("too few poses to hold any out")
    target.write_text(alone(held_out_picture(gap.held_out, bool(gap.effects)).svg), "utf-8")


def alone(svg: str) -> str:
    """A report's picture as a file of its own, in the colours of the light page."""
    css = files("solver.report").joinpath("templates/report.css").read_text("utf-8")
    light = dict(re.findall(r"--([\w-]+): ([^;]+);", css[: css.index("@media")]))
    for name, value in light.items():
        svg = svg.replace(f"var(--{name})", value.replace('"', "'"))
    svg = svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" width="810" ', 1)
    return svg.replace(">", f'><rect width="100%" height="100%" fill="{light["paper"]}"/>', 1)


if __name__ == "__main__":
    main()
