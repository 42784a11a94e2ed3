"""`loopcal sim` with faults: a script, lines typed while it runs, and what is wrong said in words."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from loopcal.cli import app
from tests.child_process import child_process

PATIENCE_S = 60.0


@contextmanager
def sim(folder: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """The virtual shoulder, ready; ended by Ctrl-C, of which it takes leave in order."""
    command = [sys.executable, "-m", "loopcal", "sim", "shoulder", *options]
    pipe = subprocess.PIPE
    with child_process(
        [*command, f"--port=shoulder-adc={folder / 'adc'}"], stdin=pipe, stderr=pipe
    ) as process:
        assert process.stdout is not None
        while not (line := process.stdout.readline()).startswith("ready"):
            assert line, process.stderr and process.stderr.read()
        yield process
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert process.returncode == 0
    assert not os.path.lexists(folder / "adc")


def wait_for(present: bool, path: Path) -> None:
    deadline, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while os.path.lexists(path) is not present:
        assert time.monotonic() < deadline, f"{path} did not {'come' if present else 'go'}"
        pause.wait(0.01)


@pytest.mark.wires
def test_a_script_and_typed_lines_happen_and_are_told(tmp_path: Path) -> None:
    script = tmp_path / "faults.txt"
    script.write_text("at 500 ms unplug lvdt-adc for 1 s\n")
    with sim(tmp_path, "--faults", str(script), "--live") as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        wait_for(False, tmp_path / "adc")
        wait_for(True, tmp_path / "adc")
        said = [process.stdout.readline().split(": ") for _ in range(2)]
        process.stdin.write("unplug shoulder-adc\nunplgu shoulder-adc\n")
        process.stdin.flush()
        wait_for(False, tmp_path / "adc")
        assert "did you mean 'unplug'?" in process.stderr.readline()
        process.stdin.write("replug shoulder-adc\n")
        process.stdin.close()
        wait_for(True, tmp_path / "adc")
    assert [what.strip() for _, what in said] == ["unplug lvdt-adc for 1 s", "end unplug lvdt-adc"]
    began, ended = (float(when.removesuffix(" s")) for when, _ in said)
    assert 0.5 <= began < ended
    assert ended >= 1.5


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("at 3 s unplug nothing", ["line 1", "word 5, 'nothing'", "lvdt-adc"]),
        (None, ["cannot read the fault script"]),
    ],
)
def test_a_script_that_cannot_be_played_is_refused_before_anything_runs(
    tmp_path: Path, script: str | None, words: list[str]
) -> None:
    path = tmp_path / "faults.txt"
    if script is not None:
        path.write_text(script)
    options = ["sim", "shoulder", f"--port=shoulder-adc={tmp_path / 'adc'}", f"--faults={path}"]
    ran = CliRunner().invoke(app, options)
    assert ran.exit_code == 2
    assert all(each in ran.stderr for each in words), ran.stderr
    assert not os.path.lexists(tmp_path / "adc")
