"""How far apart two rivals are at given stops: the T-criterion, in units of the noise.

Rival A, at its fitted size, changes whitened readings by d. Rival B, with all parameters of the
model, can take up of d what lies in the span of its columns X, and so the squared separation is

    lambda = min_z |d - X z|^2 = d'd - d'X (X'X)^+ X'd

over all stops, those captured and those to come (Atkinson & Fedorov, "The design of experiments
for discriminating between two rival models", Biometrika 62, 1975, linearised about A). Both
products are sums over stops, so that each stop is worked out once. Where noise is normal the log
likelihood of A over B is expected to be lambda / 2. Of a shape that is known only where it was seen, such as a
polynomial, nothing is promised beyond: it is taken to stay as it is there. A rival that comes in several forms (another harmonic,
another moment) may change its form when more is known: the one that is least apart counts.

Owns the sums and lambda. Which stops there could be is the business of `next_poses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from solver.effects.effect import Array, Effect
from solver.estimate.nuisance import Observations, settle
from solver.gap.fit import Fit
from solver.gap.trace import codes, traces
from solver.mechanism.circumstances import Circumstances

_RIDGE = 1e-11  # of unit columns: directions that no reading shows take up nothing


@dataclass(frozen=True)
class Contest:
    """One hypothesis, taken for true, against others.

    Attributes:
        effect: what is at work.
        coefficients: (k,) its size, SI.
        fit: where all is linearised; it may have the effect, as its last.
        others: the rivals, each in the forms that it may take; none stands for the model without any.
        noise: variance, in units of the assumed one.
    """

    effect: Effect
    coefficients: Array
    fit: Fit
    others: tuple[tuple[Effect, ...], ...]
    noise: float

    @property
    def rivals(self) -> tuple[str, ...]:
        """Their labels."""
        return tuple(forms[0].label for forms in self.others)

    @property
    def needs(self) -> frozenset[str]:
        """Fields of `Circumstances` that anything in it depends on."""
        return frozenset(n for e in (self.effect, *self._forms) for n in e.needs)

    @property
    def _forms(self) -> tuple[Effect, ...]:
        return tuple(form for forms in self.others for form in forms)

    def captured(self) -> Array:
        """(m, m) sums of products over all that was captured, and what is known beside readings."""
        rows = self._rows(self.fit)
        total = np.einsum("pca,pcb->ab", rows, rows)
        known = self._unnamed(self.fit.jacobian[self.fit.residual.size :])
        total[: known.shape[1], : known.shape[1]] += known.T @ known
        return np.asarray(total / self.noise)

    def each(self, coordinates: Array, at: Circumstances, sigma: Array) -> Array:
        """(S, m, m) the same of each of S stops that are not captured yet.

        Args:
            coordinates: (S, U) near which they would settle.
            at: their circumstances.
            sigma: (C,) standard deviations of their readings [counts].

        A stop at which the loop does not close gives nothing.
        """
        rows = self._stops(coordinates, at, sigma)
        return np.asarray(np.einsum("pca,pcb->pab", rows, rows) / self.noise)

    def summed(self, coordinates: Array, at: Circumstances, sigma: Array) -> Array:
        """(m, m) the sum of `each` over all stops, which takes less memory."""
        rows = self._stops(coordinates, at, sigma)
        flat = rows.reshape(-1, rows.shape[2])
        return np.asarray(flat.T @ flat / self.noise)

    def separation(self, sums: Array) -> Array:
        """(..., R) lambda from each rival, in its least distant form, of sums of products (..., m, m)."""
        if not self.others:
            return self.strength(sums)[..., None]
        return np.stack([each.min(axis=-1) for each in self._apart(sums)], axis=-1)

    def strength(self, sums: Array) -> Array:
        """(...) lambda from the model without any effect."""
        widths = sum(self._width(form) for form in self._forms)
        plain = np.arange(sums.shape[-1] - widths - 1)
        return self._left(sums, plain, np.zeros(0, dtype=np.intp))

    def nearest(self, sums: Sequence[Array], count: int) -> Contest:
        """The same with those forms of each rival only that are among the ``count`` least apart by any of ``sums``."""
        apart = [self._apart(each) for each in sums]
        kept = []
        for number, forms in enumerate(self.others):
            order = [np.argsort(each[number], kind="stable")[:count] for each in apart]
            kept.append(tuple(forms[i] for i in np.unique(np.concatenate(order))))
        return replace(self, others=tuple(kept))

    def _apart(self, sums: Array) -> list[Array]:
        """For each rival (..., F) lambda from each of its forms."""
        widths = [self._width(form) for form in self._forms]
        named = sums.shape[-1] - sum(widths) - 1
        begin, plain, number = named, np.arange(named), 0
        out = []
        for forms in self.others:
            each = []
            for form in forms:
                own = np.arange(begin, begin + widths[number])
                coded = codes(self.fit, form)
                taken, less = (plain, own) if coded else (np.concatenate([plain, own]), own[:0])
                each.append(self._left(sums, taken, less))
                begin, number = begin + len(own), number + 1
            out.append(np.stack(each, axis=-1))
        return out

    def _stops(self, coordinates: Array, at: Circumstances, sigma: Array) -> Array:
        """(S, C, m) `_rows` of stops that are not captured yet."""
        fit, poses = self.fit, len(coordinates)
        readings = fit.model.linearise(
            coordinates, fit.parameters, fit.space.expansion[:, :0], at
        ).readings
        observed = Observations(readings, np.tile(sigma, (poses, 1)), at)
        settled = settle(fit.model, observed, coordinates, fit.parameters, fit.space.expansion)
        there = replace(
            fit,
            observed=observed,
            settled=settled,
            jacobian=settled.jacobian.reshape(-1, settled.jacobian.shape[2]),
        )
        return self._rows(there) * settled.closed[:, None, None]

    @staticmethod
    def _left(sums: Array, taken: NDArray[np.intp], less: NDArray[np.intp]) -> Array:
        """Squared length of the last column, ``less`` others, beside the columns ``taken``."""
        columns = np.append(taken, sums.shape[-1] - 1)
        part = sums[..., columns[:, None], columns]
        if len(less):
            pick = np.zeros((sums.shape[-1], len(columns)))
            pick[columns, np.arange(len(columns))] = 1.0
            pick[less, -1] = -1.0
            part = pick.T @ sums @ pick
        length = np.sqrt(np.maximum(np.diagonal(part, axis1=-2, axis2=-1)[..., :-1], 1e-300))
        inner = part[..., :-1, :-1] / (length[..., :, None] * length[..., None, :])
        inner = inner + _RIDGE * np.eye(inner.shape[-1])
        across = part[..., :-1, -1] / length
        taken_up = np.sum(across * np.linalg.solve(inner, across[..., None])[..., 0], axis=-1)
        return np.asarray(np.maximum(part[..., -1, -1] - taken_up, 0.0))

    def _rows(self, fit: Fit) -> Array:
        """(P, C, m) whitened: parameters, one block a rival, and last what the effect does."""
        poses, channels = fit.residual.shape
        found = traces(fit, self._forms)
        (does,) = traces(fit, [self.effect], self._known(fit.values))
        own = does[:, 0] if codes(fit, self.effect) else does @ self.coefficients
        plain = self._unnamed(fit.jacobian[: poses * channels])
        return np.hstack([plain, *found, own[:, None]]).reshape(poses, channels, -1)

    def _known(self, values: Array) -> Array:
        """``values`` (P, C), or the nearest for which the effect's shape was seen."""
        if not self.effect.local:
            return values
        return np.clip(values, self.fit.values.min(axis=0), self.fit.values.max(axis=0))

    def _unnamed(self, jacobian: Array) -> Array:
        """Columns of a Jacobian (M, n) of `fit` but those of the effect itself."""
        if self.effect not in self.fit.effects:
            return jacobian
        columns = self.fit.model.columns[self.fit.effects.index(self.effect)]
        return np.delete(jacobian, np.searchsorted(self.fit.space.identified, columns), axis=1)

    def _width(self, effect: Effect) -> int:
        return 1 if codes(self.fit, effect) else len(effect.coefficients)
