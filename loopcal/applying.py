"""`loopcal apply`: a result put to use on a recording: poses, the calibrated rig, channel corrections."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from loopcal.console import fail, out
from loopcal.files import create
from loopcal.solving import write_json
from recordings.reader import read_recording
from recordings.rig import Rig, SerialMechanism, parameters
from recordings.rig.edit import Calibrated, with_values
from solver.calibration import Calibration, EndPoses
from solver.drives import held_joints
from solver.effects.correction import corrections
from solver.samples import PoseTable, average

COLUMNS = (
    "pose", "visit", "x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg",
    "se_x_m", "se_y_m", "se_z_m", "se_rx_deg", "se_ry_deg", "se_rz_deg", "misfit",
)  # fmt: skip
"""Columns of the table of poses: position, rotation vector, their standard errors, misfit."""

_SHOWN = 10


def run_apply(
    result: Path, file: Path, *, output: Path | None, rig_out: Path | None, corrections: Path | None
) -> None:
    """Turn the dwells of a recording into calibrated poses, and write what was asked for."""
    document = _document(result)
    recording = read_recording(file)
    calibration = Calibration.of(recording.rig, document)
    table = average(recording)
    poses = calibration.end_poses(
        table.counts,
        table.sigma,
        table.circumstances(recording.rig),
        held_joints(recording, table.windows) if recording.rig.effects else None,
    )
    rows = _rows(table, poses)
    if output is not None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(rows)
        create(output, text.getvalue())
    if rig_out is not None:
        create(rig_out, calibrated_rig(recording.rig, recording.rig_toml, document))
    if corrections is not None:
        write_json(channel_corrections(recording.rig, calibration), corrections)
    _show(recording.rig, rows)


def calibrated_rig(rig: Rig, text: str, document: Any) -> str:
    """The rig file with every identified value in it, and its standard error as uncertainty."""
    table = {p.name: p for p in parameters(rig)}
    values = {}
    for entry in document["parameters"]:
        if entry["identified"]:
            p = table[entry["name"]]
            error = None if entry["standard_error"] is None else entry["standard_error"] * p.to_si
            values[p.name] = Calibrated(entry["value"] * p.to_si, error, p.dimension)
    return with_values(text, values)


def channel_corrections(rig: Rig, calibration: Calibration) -> dict[str, Any]:
    """What a controller needs to turn counts into calibrated values, channel by channel.

    value = gain (counts - zero_count) + offset; a joint's angle in the model is that value
    plus its theta_offset. Where effects sit at a channel, that is what it reads; `correction` is a
    table from there to what is true, with straight lines between its points.

    Raises:
        NotEnoughData: the rig has an effect that no channel can undo by itself.
    """
    undone = corrections(calibration.model, calibration.parameters)
    values = dict(
        zip((p.name for p in calibration.space.table), calibration.parameters, strict=True)
    )
    shown = {p.name: p for p in calibration.space.table}
    channels = []
    for channel in rig.channels:
        gain, offset = shown[f"{channel.name}.gain"], shown[f"{channel.name}.offset"]
        turn = shown.get(f"{channel.senses}.theta_offset")
        channels.append(
            {
                "name": channel.name,
                "senses": channel.senses,
                "unit": offset.unit,
                "zero_count": channel.zero_count,
                "gain": values[gain.name] / gain.to_si,
                "offset": values[offset.name] / offset.to_si,
                "theta_offset": None if turn is None else values[turn.name] / turn.to_si,
                "correction": None
                if channel.name not in undone
                else {
                    "read": (undone[channel.name].read / offset.to_si).tolist(),
                    "true": (undone[channel.name].true / offset.to_si).tolist(),
                },
            }
        )
    return {"schema": 1, "rig": rig.name, "channels": channels}


def _document(path: Path) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except OSError as error:
        fail(f"cannot read the result file '{path}': {error.strerror}")
    except ValueError:
        fail(f"'{path}' is not a result file; `loopcal solve FILE --json RESULT` writes one")


def _rows(table: PoseTable, poses: EndPoses) -> list[list[object]]:
    from solver.mechanism.rotation import logarithm

    turned = np.rad2deg(logarithm(poses.rotation))
    errors = np.sqrt(np.diagonal(poses.covariance, axis1=1, axis2=2))
    rows: list[list[object]] = []
    for i, window in enumerate(table.windows):
        numbers = [*poses.position[i], *turned[i], *errors[i, :3], *np.rad2deg(errors[i, 3:])]
        misfit = poses.misfit[i]
        tail = "" if np.isnan(misfit) else f"{misfit:.3f}"
        rows.append([window.pose, window.visit, *(f"{value:.9g}" for value in numbers), tail])
    return rows


def _show(rig: Rig, rows: list[list[object]]) -> None:
    what = "endpoint" if isinstance(rig.mechanism, SerialMechanism) else "plate"
    out.print(f"{what} in the base frame at {len(rows)} dwells", style="bold")
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in ("pose", "x", "y", "z [mm]", "± SE", "rx", "ry", "rz [deg]", "± SE "):
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows[:_SHOWN]:
        n = [float(str(value)) for value in row[2:14]]
        at = [f"{1e3 * value:.3f}" for value in n[:3]]
        turned = [f"{value:.4f}" for value in n[3:6]]
        table.add_row(str(row[0]), *at, f"{1e3 * max(n[6:9]):.3f}", *turned, f"{max(n[9:12]):.4f}")
    out.print(table)
    if len(rows) > _SHOWN:
        out.print(f"and {len(rows) - _SHOWN} more; -o FILE.csv writes all of them", markup=False)
