"""The pytest plug-in in a pytest of its own: the examples of its page, its manners, its leaks."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "howto-pytest.md"
EXAMPLE = re.compile(r"<!-- (test_\w+\.py) -->\n```python\n(.*?)```", re.DOTALL)
TIMEOUT_S = 100.0


def pytest_in(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """A pytest without any setting but its own defaults."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        *options,
        str(folder),
    ]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )


def write(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(textwrap.dedent(text))


@pytest.mark.wires
def test_the_examples_of_the_page_run(tmp_path: Path) -> None:
    examples = EXAMPLE.findall(PAGE.read_text("utf-8"))
    assert [name for name, _ in examples] == ["test_memory.py", "test_ports.py"]
    for name, code in examples:
        write(tmp_path, name, code)
    for _ in range(8):  # a session that a computer held up for a second ends for that, as it should
        ran = pytest_in(tmp_path, "-W", "error")
        if "held up for" not in ran.stdout:
            break
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "2 passed" in ran.stdout


def test_it_imports_nothing_and_changes_no_setting_while_it_is_not_used(tmp_path: Path) -> None:
    write(
        tmp_path,
        "test_manners.py",
        """
        import sys
        import time
        import warnings

        def test_nothing_is_imported(pytestconfig):
            assert pytestconfig.pluginmanager.has_plugin("loopcal")
            rooms = {"recordings", "drivers", "daq", "solver", "numpy", "can", "serial"}
            assert not rooms & set(sys.modules)
            assert {m for m in sys.modules if m.startswith("sim_devices")} == {
                "sim_devices", "sim_devices.pytest_plugin"
            }

        def test_warnings_are_as_the_project_wants_them():
            warnings.warn("mine", UserWarning)
            assert time.monotonic.__module__ == "time" or "built-in" in repr(time.monotonic)
        """,
    )
    ran = pytest_in(tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "2 passed, 1 warning" in ran.stdout


@pytest.mark.wires
def test_a_test_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    write(
        tmp_path,
        "test_leaks.py",
        """
        import os
        import threading
        import time

        REAL = time.monotonic
        before = threading.active_count(), len(os.listdir("/proc/self/fd"))
        paths = []

        def test_that_fails(loopcal_rig, loopcal_memory_rig):
            bench = loopcal_rig("shoulder", plant=Nothing())
            paths.extend(bench.ports.values())
            assert all(os.path.exists(path) for path in paths)
            loopcal_memory_rig("shoulder", plant=Nothing())
            assert False, "as a test may"

        def test_that_looks():
            assert threading.active_count() == before[0]
            assert len(os.listdir("/proc/self/fd")) <= before[1]
            assert paths and not any(os.path.lexists(path) for path in paths)
            assert time.monotonic is REAL

        def test_what_is_wrong_is_said_in_the_test(loopcal_rig):
            loopcal_rig("shoulder", faults="at 3 s unplgu shoulder-adc", plant=Nothing())

        class Nothing:
            def advance(self, time_s): ...
            def sense(self, channel): return 0
            def command(self, joint, mode, target_raw): ...
            def drive_fault(self, joint): return 0
        """,
    )
    ran = pytest_in(tmp_path, "-p", "no:randomly")
    assert ran.returncode == 1, ran.stdout + ran.stderr
    assert "1 passed" in ran.stdout
    assert "2 failed" in ran.stdout
    assert "as a test may" in ran.stdout
    assert "did you mean 'unplug'" in ran.stdout
