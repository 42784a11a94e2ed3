"""What the solver answers, given a recording and nothing else; and what simpler methods would say.

Knows nothing of how the recording came to be: it takes the path of a file, and imports neither
nature nor what was sealed.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from loopcal.blind.baselines import baselines
from recordings.reader import read_recording
from solver.errors import SolverError
from solver.gap.analysis import analyse
from solver.gap.result import gap_json

Answer = dict[str, Any]
"""The solver's answer as plain data (`solver.gap.result.gap_json`), what baselines name, the processor's time."""


def answer(recording: Path) -> Answer:
    """Analyse ``recording``; an error of the solver's is an answer too, and a bad one."""
    begin = time.process_time()
    try:
        gap = analyse(read_recording(recording))
    except (SolverError, np.linalg.LinAlgError) as error:
        return {
            "verdict": "error",
            "error": f"{type(error).__name__}: {error}",
            "effects": [],
            "seconds": time.process_time() - begin,
            "baselines": {},
        }
    seconds = time.process_time() - begin
    told = gap_json(gap)
    return {
        "verdict": told["verdict"],
        "reasons": told["reasons"],
        "effects": told["effects"],
        "gap": told["gap"],
        "noise_floor": told["noise_floor"],
        "screen_p": told["screen_p"],
        "unknown_p": gap.unknown.p,
        "poses": len(gap.table.counts),
        "seconds": seconds,
        "baselines": baselines(gap.search.before),
    }
