"""What simpler methods name, from the same residual and the same traces as the solver.

Each names effects as ``name@where`` labels, in the order in which it believes in them:

- correlation: the candidate whose whole trace correlates most with the residual, where a plain
  5 % test of that correlation passes;
- screening: the candidate of lowest p after projection, where it is below 5 % (no correction for
  how many were tried);
- bic: forward selection by Schwarz's criterion (Ann. Statist. 6, 1978), up to four effects;
- lasso: Tibshirani's lasso (J. R. Statist. Soc. B 58, 1996) over all columns at the universal
  penalty sigma sqrt(2 log p), effects in the order of what their columns explain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.gap.score import log_f_tail
from solver.gap.search import MOST, Look

Array = NDArray[np.float64]

_LEVEL = np.log(0.05)
_SWEEPS = 200
_SETTLED = 1e-6


def baselines(look: Look) -> dict[str, list[str]]:
    """What each method names, of the candidates and the residual of ``look``."""
    fit, shapes = look.fit, [form for form in look.forms if form.basis.shape[1]]
    r = fit.projected(fit.stacked[:, None])[:, 0]
    labels = [look.candidates[form.candidate].label for form in shapes]
    if not labels:
        return {name: [] for name in ("correlation", "screening", "bic", "lasso")}
    total, freedoms = float(r @ r), fit.freedoms
    width = np.array([form.basis.shape[1] for form in shapes])
    explained = np.array([float(np.sum((form.basis.T @ r) ** 2)) for form in shapes])
    retained = np.array([form.retained for form in shapes])
    log_p = log_f_tail(explained, width, total, freedoms)
    naive = log_f_tail(explained * retained, width, total, freedoms)
    seen = int(np.argmax(explained * retained))
    surest = int(np.argmin(log_p))
    return {
        "correlation": [labels[seen]] if naive[seen] < _LEVEL else [],
        "screening": [labels[surest]] if log_p[surest] < _LEVEL else [],
        "bic": _stepwise(r, [form.basis for form in shapes], labels, freedoms),
        "lasso": _lasso(r, [form.basis for form in shapes], labels, freedoms),
    }


def _stepwise(r: Array, bases: list[Array], labels: list[str], freedoms: int) -> list[str]:
    """Add what lowers m log(RSS) + k log(m) most, while anything does."""
    chosen: list[str] = []
    left, price = r, np.log(freedoms)
    taken: Array = np.zeros((len(r), 0))
    for _ in range(MOST):
        total = float(left @ left)
        best, gain, basis = -1, 0.0, taken
        for i, form in enumerate(bases):
            if labels[i] in chosen:
                continue
            beside = form - taken @ (taken.T @ form)
            vectors, singular, _ = np.linalg.svd(beside, full_matrices=False)
            fresh = vectors[:, singular > 1e-4]
            now = -freedoms * np.log1p(-min(float(np.sum((fresh.T @ left) ** 2)) / total, 0.999999))
            now -= fresh.shape[1] * price
            if now > gain:
                best, gain, basis = i, now, fresh
        if best < 0:
            break
        chosen.append(labels[best])
        taken = np.column_stack([taken, basis])
        left = left - basis @ (basis.T @ left)
    return chosen


def _lasso(r: Array, bases: list[Array], labels: list[str], freedoms: int) -> list[str]:
    """Coordinate descent over all columns together, each of unit length."""
    columns = np.concatenate(bases, axis=1)
    owner = [label for form, label in zip(bases, labels, strict=True) for _ in range(form.shape[1])]
    noise = float(np.sqrt(r @ r / freedoms))
    penalty = noise * np.sqrt(2.0 * np.log(columns.shape[1]))
    gram, pull = columns.T @ columns, columns.T @ r
    weights = np.zeros(len(pull))
    for _ in range(_SWEEPS):
        before = weights.copy()
        for j in range(len(weights)):
            rho = pull[j] - gram[j] @ weights + weights[j]
            weights[j] = np.sign(rho) * max(abs(rho) - penalty, 0.0)
        if np.abs(weights - before).max() < _SETTLED * noise:
            break
    share: dict[str, float] = {}
    for label, weight in zip(owner, weights, strict=True):
        if weight != 0.0:
            share[label] = share.get(label, 0.0) + weight**2
    return sorted(share, key=lambda label: -share[label])
