"""A calibration in use: readings become the pose of the endpoint or the plate, with its uncertainty.

For an arm whose joints between base and end are all sensed this is forward kinematics of the
calibrated chain, effects undone; it holds in free space as well as on the fixture. For platforms, and for chains
with an unsensed joint on the way, it is the most likely pose given all readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.rig import Rig, parameters
from solver.effects.needs import loaded, require_known
from solver.errors import SolverError
from solver.estimate.nuisance import Observations, assemble, settle
from solver.forward import forward, read, sensed_all_the_way
from solver.mechanism.circumstances import Circumstances
from solver.mechanism.model import EndPose, Model, model_of
from solver.mechanism.space import ParameterSpace

Array = NDArray[np.float64]


class ResultError(SolverError):
    """A result file does not say what is needed, or belongs to another rig."""


@dataclass(frozen=True)
class EndPoses:
    """P poses of the endpoint or plate in the base frame.

    Attributes:
        rotation: (P, 3, 3), base from end.
        position: (P, 3) [m].
        covariance: (P, 6, 6) of [position; small rotation about the base axes] [m, rad].
        misfit: (P,) root mean square of the whitened readings, where readings are redundant;
            nan for plain forward kinematics.
    """

    rotation: Array
    position: Array
    covariance: Array
    misfit: Array


@dataclass(frozen=True)
class Calibration:
    """A rig with the parameters that a solve found.

    Attributes:
        model: mechanism and sensors.
        space: the parameters; ``space.names`` are the identified ones.
        parameters: (N,) SI.
        covariance: (n, n) of the identified ones, SI.
    """

    model: Model
    space: ParameterSpace
    parameters: Array
    covariance: Array

    @classmethod
    def of(cls, rig: Rig, document: Mapping[str, Any]) -> Calibration:
        """The calibration in a result file's JSON ``document``, for ``rig``.

        Raises:
            ResultError: not a result, or one of another rig.
        """
        table = parameters(rig)
        try:
            found = {entry["name"]: entry for entry in document["parameters"]}
            names = list(document["covariance"]["parameters"])
            matrix = np.array(document["covariance"]["matrix"], dtype=np.float64).reshape(
                len(names), len(names)
            )
            missing = [p.name for p in table if p.name not in found]
            if missing:
                raise ResultError(
                    f"the result of rig '{document['rig']}' has no parameter '{missing[0]}' of rig '{rig.name}'; "
                    "solve a recording of this rig"
                )
            values = np.array([float(found[p.name]["value"]) * p.to_si for p in table])
            if not (np.isfinite(values).all() and np.isfinite(matrix).all()):
                raise ResultError(
                    "the result holds numbers that are not finite; solve the recording again"
                )
        except (KeyError, TypeError, ValueError) as error:
            raise ResultError(
                "this is not a result file with a covariance; `loopcal solve FILE --json RESULT` writes one"
            ) from error
        space = ParameterSpace.of(table, names)
        scale = np.array([table[i].to_si for i in space.identified])
        return cls(model_of(rig), space, values, matrix * scale[:, None] * scale)

    def end_poses(
        self,
        counts: Array,
        sigma: Array,
        at: Circumstances | None = None,
        held: NDArray[np.bool_] | None = None,
    ) -> EndPoses:
        """Endpoint or plate at readings ``counts`` (P, C) with standard deviations ``sigma`` (P, C) [counts].

        ``at`` and ``held`` (P, J), whether drives held the joints, matter where the rig has effects. Loads
        are those of the mechanism in its fixture, unless the arm compensates gravity.

        Raises:
            NotEnoughData: an effect depends on what nobody knows of these readings.
        """
        observed = Observations(counts, sigma, at)
        if sensed_all_the_way(self.model):
            shown = read(self.model, counts, self.parameters)
            observed = loaded(self.model, observed, shown, self.parameters, held)
            require_known(self.model, observed.at)
            found = forward(self.model, observed, self.parameters, self.space.expansion)
            noisy = found.by_readings * sigma[:, None, :]
            unknown = np.full(len(counts), np.nan)
            return self._with_parameters(
                found.end, found.end.by_parameters, noisy @ _t(noisy), unknown
            )
        start = assemble(self.model, observed, self.parameters)
        observed = loaded(self.model, observed, start, self.parameters, held)
        require_known(self.model, observed.at)
        settled = settle(self.model, observed, start, self.parameters, self.space.expansion)
        end = self.model.end_pose(
            settled.coordinates, self.parameters, self.space.expansion, observed.at
        )
        spread = (
            end.by_coordinates
            @ self._coordinate_spread(observed, settled.coordinates)
            @ _t(end.by_coordinates)
        )
        misfit = np.sqrt(np.mean(settled.residual**2, axis=1))
        return self._with_parameters(
            end, end.by_parameters + end.by_coordinates @ settled.following, spread, misfit
        )

    def _with_parameters(
        self, end: EndPose, by_parameters: Array, spread: Array, misfit: Array
    ) -> EndPoses:
        covariance = spread + by_parameters @ self.covariance @ _t(by_parameters)
        return EndPoses(end.rotation, end.position, covariance, misfit)

    def _coordinate_spread(self, observed: Observations, coordinates: Array) -> Array:
        """(P, U, U) covariance of the most likely coordinates: the leading block of the inverse KKT matrix."""
        nowhere = self.space.expansion[:, :0]
        at = self.model.linearise(coordinates, self.parameters, nowhere, observed.at)
        H = at.readings_by_coordinates / observed.sigma[:, :, None]
        norms = np.linalg.norm(H, axis=1)
        scale = 1.0 / np.where(norms > 0, norms, np.max(norms, axis=1, keepdims=True))
        H = H * scale[:, None, :]
        A = at.closure_by_coordinates * scale[:, None, :]
        A = A / np.maximum(np.linalg.norm(A, axis=2, keepdims=True), 1e-300)
        size, closures = H.shape[2], A.shape[1]
        kkt = np.zeros((len(H), size + closures, size + closures))
        kkt[:, :size, :size] = _t(H) @ H
        kkt[:, size:, :size], kkt[:, :size, size:] = A, _t(A)
        spread: Array = np.linalg.pinv(kkt, hermitian=True)[:, :size, :size]
        unscaled: Array = spread * scale[:, :, None] * scale[:, None, :]
        return unscaled


def _t(stack: Array) -> Array:
    out: Array = np.swapaxes(stack, 1, 2)
    return out
