"""How much faster than real time `loopcal simulate` is: python benchmarks/simulate_speed.py

Runs in-process after one warm-up, file writing included, and prints a line a case.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from recordings.rig import parse_rig, rig_text
from sim_devices.plant.creation import make_nature
from sim_devices.plant.session import play
from sim_devices.simulate import simulate

CASES = (("arm", None), ("arm", 450), ("shoulder", None), ("shoulder", 450))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, poses) in enumerate((CASES[0], *CASES)):
            text, source = rig_text(name)
            rig = parse_rig(text, source)
            path = Path(folder) / f"{number}.mcap"
            start = time.perf_counter()
            simulate(rig, text, path, poses=poses, seed=1)
            took_s = time.perf_counter() - start
            session_s = play(make_nature(rig, 1), poses).course.time_s[-1]
            if number > 0:
                print(
                    f"{name:9s} {poses or 'plan':>5} poses: session {session_s:7.1f} s, "
                    f"simulated in {took_s:6.2f} s, {session_s / took_s:5.0f} times real time, "
                    f"{path.stat().st_size / 1e6:.2f} MB"
                )


if __name__ == "__main__":
    main()
