"""A third party as judge: ``mbpoll`` (Debian's package, on libmodbus) polls the virtual converters.

Where the program is not installed, the one test of this file says so by its name, and
`test_peer_modbus` has other clients.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Mapping

import pytest

from recordings.rig import Rig, parse_rig
from tests.drivers.families import FAMILIES

pytestmark = [pytest.mark.wires, pytest.mark.usefixtures("no_leaks")]

MBPOLL = shutil.which("mbpoll")


def mbpoll(*arguments: str) -> str:
    """What the program prints; 0 is the first register."""
    command = [str(MBPOLL), "-1", "-0", "-o", "5", "-q", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    return done.stdout + done.stderr


def values(printed: str) -> dict[int, int]:
    """Values by register."""
    return {
        int(register): int(value)
        for register, value in re.findall(r"^\[(\d+)\]:\s+(-?\d+)", printed, re.MULTILINE)
    }


def rtu_input_registers(rig: Rig, plant, running) -> None:
    plant.counts = {"d1": 2048, "d2": 0, "d3": 4095, "d4": -1}
    with running(rig, plant) as addresses:
        line = ["-m", "rtu", "-b", "115200", "-P", "none", addresses["shoulder-adc"]]
        got = values(mbpoll("-a", "1", "-t", "3", "-r", "0", "-c", "5", *line))
        assert got == {0: 1, 1: 2048, 2: 0, 3: 4095, 4: 65535}


def rtu_settings_are_written(rig: Rig, plant, running) -> None:
    with running(rig, plant) as addresses:
        line = ["-m", "rtu", "-b", "115200", "-P", "none", addresses["shoulder-adc"]]
        assert "Written 2 references" in mbpoll(
            "-a", "1", "-t", "4", "-r", "61440", *line, "8", "99"
        )
        got = values(mbpoll("-a", "1", "-t", "4", "-r", "61440", "-c", "2", *line))
        assert got == {61440: 8, 61441: 99}


def rtu_refusals_and_silence(rig: Rig, plant, running) -> None:
    with running(rig, plant) as addresses:
        line = ["-m", "rtu", "-b", "115200", "-P", "none", addresses["shoulder-adc"]]
        assert "Illegal data address" in mbpoll("-a", "1", "-t", "3", "-r", "300", *line)
        assert "Illegal data value" in mbpoll("-a", "1", "-t", "4", "-r", "61440", *line, "0")
        assert "timed out" in mbpoll("-o", "0.2", "-a", "2", "-t", "3", "-r", "0", *line)


def tcp_in_every_order(rig: Rig, plant, running) -> None:
    text = FAMILIES["modbus-tcp"].text.replace('order = "BADC"', 'order = "ABCD"')
    plant.counts = {"q1": -70_000, "q2": 6}
    with running(parse_rig(text), plant) as addresses:
        host, _, port = addresses["line"].rpartition(":")
        there = ["-m", "tcp", "-p", port, host]
        unit = ["-a", "255"]
        assert values(mbpoll(*unit, "-t", "3:int", "-B", "-r", "10", *there)) == {10: -70_000}
        printed = mbpoll(*unit, "-t", "3:float", "-B", "-r", "14", *there)
        assert re.search(r"^\[14\]:\s+1\.5\b", printed, re.MULTILINE), printed
        first, again = (
            values(mbpoll(*unit, "-t", "3:int", "-r", "8", *there))[8] for _ in range(2)
        )
        assert again == first + 1


JUDGEMENTS: Mapping[str, Callable[..., None]] = {
    each.__name__: each
    for each in (
        rtu_input_registers,
        rtu_settings_are_written,
        rtu_refusals_and_silence,
        tcp_in_every_order,
    )
}

if MBPOLL is None:

    def test_mbpoll_is_absent_install_the_debian_package_mbpoll() -> None:
        assert shutil.which("mbpoll") is None

else:

    @pytest.mark.parametrize("judgement", JUDGEMENTS)
    def test_mbpoll(judgement: str, shoulder_here: Rig, plant, running) -> None:
        JUDGEMENTS[judgement](shoulder_here, plant, running)
