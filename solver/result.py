"""The result file of a solve: the JSON document that other programs read.

Owns the keys that `docs/formats.md` describes. Values are in the units shown (m, deg,
m/count, deg/count); keys that do not apply to a mechanism are null.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from recordings.rig import Parameter
from solver.estimate.estimate import Estimate
from solver.poses.observability import Observability
from solver.solve import Solution

SCHEMA = 1


def result(solution: Solution) -> dict[str, Any]:
    """The JSON document of ``solution``."""
    estimate, space = solution.estimate, solution.estimate.space
    errors = dict(zip(space.names, estimate.standard_errors, strict=True))
    after = solution.closure_after
    residual = solution.after.residual[solution.selection.poses]
    return {
        "schema": SCHEMA,
        "rig": solution.rig.name,
        "mechanism": solution.rig.mechanism.family,
        "method": estimate.method,
        "status": estimate.status.word,
        "iterations": estimate.iterations,
        "poses": {
            "recorded": len(solution.table.counts),
            "used": len(solution.selection.poses) - estimate.left_out,
            "rejected": len(solution.table.rejected),
            "downweighted": [
                {"pose": int(solution.selection.poses[i]), "weight": float(estimate.weights[i])}
                for i in estimate.downweighted
                if estimate.weights is not None
            ],
        },
        "loss": estimate.loss.value,
        "priors": estimate.priors,
        "parameters": [
            _parameter(p, float(value), errors.get(p.name))
            for p, value in zip(space.table, estimate.parameters, strict=True)
        ],
        "covariance": _covariance(estimate),
        "unidentifiable": [
            {"combination": words, "held_by": by}
            for words, by in zip(
                solution.identifiability.combinations, solution.identifiability.held_by, strict=True
            )
        ],
        "findings": [
            {"kind": found.kind, "grade": found.grade, "text": found.text}
            for found in solution.findings
        ],
        "condition_number": {
            "raw": _number(solution.raw.condition),
            "scaled": _number(solution.scaled.condition),
        },
        "observability": {"raw": _indices(solution.raw), "scaled": _indices(solution.scaled)},
        "residual": {
            "position_rms_m": None if after is None else after.position_rms,
            "orientation_rms_rad": None if after is None else after.orientation_rms,
            "predicted_position_rms_m": None if after is None else after.position_predicted,
            "predicted_orientation_rms_rad": None if after is None else after.orientation_predicted,
            "chi2_per_dof": _number(estimate.misfit),
            "degrees_of_freedom": estimate.freedoms,
            "standard_errors_inflated_by": estimate.inflation,
            "paper_sigma_position_m": None if after is None else after.sigma_position_as_printed,
            "paper_sigma_orientation_rad": None
            if after is None
            else after.sigma_orientation_as_printed,
            "channels": [
                {
                    "name": name,
                    "noise_counts": float(solution.table.noise[c]),
                    "whitened_rms": float(np.sqrt(np.mean(residual[:, c] ** 2))),
                }
                for c, name in enumerate(solution.table.channels)
            ],
        },
        "selection": {
            "criterion": solution.selection.criterion,
            "value": solution.selection.value,
            "upper_bound": solution.selection.upper_bound,
            "poses": [int(i) for i in solution.selection.poses],
        },
        "beside": [
            {
                "method": other.method,
                "status": other.status.word,
                "chi2_per_dof": _number(other.misfit),
                "parameters": [
                    {
                        "name": name,
                        "value": float(value / space.table[i].to_si),
                        "unit": space.table[i].unit,
                        "standard_error": _number(float(error / space.table[i].to_si)),
                    }
                    for name, i, value, error in zip(
                        space.names,
                        space.identified,
                        other.values,
                        other.standard_errors,
                        strict=True,
                    )
                ],
            }
            for other in solution.beside
        ],
    }


def _covariance(estimate: Estimate) -> dict[str, Any]:
    """Of the identified parameters, in the units shown: that behind the standard errors."""
    space = estimate.space
    scale = np.array([1.0 / space.table[i].to_si for i in space.identified])
    matrix = estimate.spread * scale[:, None] * scale
    return {
        "parameters": list(space.names),
        "matrix": [[_number(float(v)) for v in row] for row in matrix],
    }


def _parameter(parameter: Parameter, value: float, error: float | None) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "value": value / parameter.to_si,
        "unit": parameter.unit,
        "standard_error": None if error is None else _number(error / parameter.to_si),
        "nominal": parameter.nominal / parameter.to_si,
        "identified": error is not None,
    }


def _indices(of: Observability) -> dict[str, Any]:
    return {
        "sigma_L": of.sigma_min,
        "product": of.product,
        "condition": _number(of.condition),
        "singular_values": [float(value) for value in of.singular_values],
    }


def _number(value: float) -> float | None:
    """JSON has no infinities: they are null."""
    return value if math.isfinite(value) else None
