"""What people hand in as files: rigs, plans, tables of poses, URDFs, results."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stderr, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from recordings.errors import RecordingsError, RigError, TableError
from recordings.reader import read_recording
from recordings.rig import load_plan, load_rig, parameters, parse_rig, rig_text
from recordings.tables import Table, import_tables
from recordings.urdf import rig_from_urdf
from solver.calibration import Calibration
from solver.errors import SolverError
from tests.fuzzing.recording_targets import RIG
from tests.fuzzing.target import Target

PLAN = """\
[plan]
mode = "driven"
drives = ["joint1", "joint2"]
corners_deg = [[0, 0], [10, 0], [0, 10]]
poses = 5
revisit = { poses = 2, visits = 2 }
dwell_s = 0.5
settle_s = 0.2
seed = 4
"""
TABLES = (
    "q1_deg,pose,visit,direction\n1.5,0,0,up\n-2.25,1,0,\n3,0,1,down\n",
    "q1_counts\n100\n-7\n",
    "q1_rad;\n1,2\n",
)
URDF = """\
<?xml version="1.0"?>
<robot name="two">
  <link name="base"/><link name="upper"/><link name="tool"/><link name="tip"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 1.5707963 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="reach" type="prismatic">
    <parent link="upper"/><child link="tool"/>
    <origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="tool"/><child link="tip"/></joint>
</robot>
"""


@cache
def _rigs() -> tuple[bytes, ...]:
    return (RIG.encode(), *(rig_text(name)[0].encode() for name in ("arm", "shoulder")))


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _check_rig(data: bytes) -> None:
    with suppress(RigError):
        rig = parse_rig(_text(data))
        for parameter in parameters(rig):
            assert np.isfinite(parameter.nominal), parameter


def _check_plan(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.toml"
        path.write_bytes(data)
        with suppress(RigError):
            load_plan(path)


def _check_table(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "table.csv", Path(folder) / "a.mcap"
        path.write_bytes(data)
        try:
            count = import_tables(parse_rig(RIG), RIG, [Table(path)], out)
        except (TableError, RecordingsError):
            assert not out.exists(), "an error left a file behind"
            return
        assert len(read_recording(out).readings["q1"]) == count


def _check_urdf(data: bytes) -> None:
    # The parser of URDFs tells of what it passes over on the terminal.
    with redirect_stderr(io.StringIO()), suppress(RigError):
        text = rig_from_urdf(_text(data), "tip", "ball")
        parse_rig(text)


@cache
def _result() -> tuple[bytes, ...]:
    rig = load_rig("shoulder")
    names = [p.name for p in parameters(rig) if p.identify]
    document: dict[str, Any] = {
        "schema": 1,
        "rig": rig.name,
        "parameters": [
            {"name": p.name, "value": p.nominal / p.to_si, "unit": p.unit, "standard_error": 0.1}
            for p in parameters(rig)
        ],
        "covariance": {"parameters": names, "matrix": np.eye(len(names)).tolist()},
    }
    return (json.dumps(document, indent=0).encode(),)


def _check_result(data: bytes) -> None:
    with suppress(ValueError):  # not JSON: told by the command, before this reader
        document = json.loads(data)
        with suppress(SolverError):
            found = Calibration.of(load_rig("shoulder"), document)
            assert np.isfinite(found.parameters).all()
            assert np.isfinite(found.covariance).all()


def _lines(*texts: str) -> Sequence[bytes]:
    return [text.encode() for text in texts]


TARGETS = (
    Target("rig", _rigs, _check_rig, (b"[[channel]]", b"{", b"nominal = ", b'""" '), text=True),
    Target("plan", lambda: _lines(PLAN), _check_plan, (b"[[plan.revisit]]",), text=True),
    Target("table", lambda: _lines(*TABLES), _check_table, (b"q1_deg", b",", b'"'), text=True),
    Target("urdf", lambda: _lines(URDF), _check_urdf, (b"<!ENTITY", b"&amp;", b"]]>"), text=True),
    Target("result", _result, _check_result, (b"[", b"{", b":"), text=True),
)
