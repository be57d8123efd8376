"""Logistic regression with signs: the chance that a verdict is right, from a rollout's features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit

from recast.arrays import Array
from recast.metrics.trust.features import FEATURES

READ = tuple(name for name, feature in FEATURES.items() if feature.sign is not None)
"""Features that the model reads, in the order of its coefficients."""
RIDGE = 1.0
"""Weight of the squared coefficients against one rollout's loss."""
_INTERCEPT_RIDGE = 0.01
"""Keeps the intercept finite where all verdicts are alike; elsewhere it changes little."""
MOST_DEVIATIONS = 3.0
"""Standardised features end here, so that no single one far from all data decides."""


@dataclass(frozen=True)
class TrustModel:
    """Coefficients (F,) of standardised features, and how these are standardised.

    Attributes:
        means, scales: (F,) means and scales of the features in the data, after the logarithm of
            those that have one.
    """

    intercept: float
    coefficients: Array
    means: Array
    scales: Array

    def standardised(self, values: Mapping[str, float]) -> Array:
        """(F,) features less their means, in units of their scales; 0 for one that is missing."""
        return _within((_row(values) - self.means) / self.scales)

    def parts(self, values: Mapping[str, float]) -> dict[str, float]:
        """What each feature adds to the log-odds, against its mean; 0 for one that is missing."""
        added = (self.coefficients * self.standardised(values)).tolist()
        return dict(zip(READ, added, strict=True))

    def trust(self, values: Mapping[str, float]) -> float:
        """The chance that the verdict is right, 0 to 1."""
        return float(expit(self.intercept + sum(self.parts(values).values())))


def fit_model(
    features: Sequence[Mapping[str, float]], agrees: ArrayLike, ridge: float = RIDGE
) -> TrustModel:
    """The model of rollouts whose verdicts are known to be right or wrong.

    Minimises the sum of log losses plus half `ridge` times the squared coefficients of standardised
    features. Each coefficient has the sign of its feature, or is zero.

    Args:
        features: features of N rollouts, by name; a missing one counts as the mean of the others.
        agrees: (N,) bool, whether each verdict is right.

    Raises:
        ValueError: no rollout.
    """
    labels = np.asarray(agrees, np.float64)
    if len(features) == 0 or labels.shape != (len(features),):
        raise ValueError(f"fit_model: {len(features)} rollouts, but labels of shape {labels.shape}")
    raw = np.stack([_row(values) for values in features])
    known = np.isfinite(raw)
    count = np.maximum(known.sum(axis=0), 1)
    means = np.where(known, raw, 0.0).sum(axis=0) / count
    deviations = np.where(known, raw - means, 0.0)
    scales = np.sqrt((deviations**2).sum(axis=0) / count)
    # A feature that never changes tells nothing; rounding leaves it a scale of its own size.
    constant = scales <= 1e-9 * np.maximum(np.abs(means), 1.0)
    scales = np.where(constant, 1.0, scales)
    table = np.where(constant, 0.0, _within(deviations / scales))
    bounds = [(None, None), *(_BOUNDS[FEATURES[name].sign or 0] for name in READ)]
    found = minimize(
        lambda at: loss(at, table, labels, ridge),
        np.zeros(1 + len(READ)),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 1000, "ftol": 1e-14, "gtol": 1e-9},
    )
    return TrustModel(float(found.x[0]), np.asarray(found.x[1:]), means, scales)


def loss(at: Array, table: Array, labels: Array, ridge: float) -> tuple[float, Array]:
    """The regularised log loss and its gradient (1 + F,).

    Args:
        at: (1 + F,) intercept and coefficients.
        table: (N, F) standardised features.
        labels: (N,) 0 or 1.
    """
    weights = np.concatenate([[_INTERCEPT_RIDGE], np.full(len(at) - 1, ridge)])
    odds = at[0] + table @ at[1:]
    value = np.sum(np.logaddexp(0.0, odds) - labels * odds) + 0.5 * float(weights @ at**2)
    wrong = expit(odds) - labels
    return float(value), np.concatenate([[wrong.sum()], wrong @ table]) + weights * at


_BOUNDS: Mapping[int, tuple[float | None, float | None]] = {
    -1: (None, 0.0),
    0: (None, None),
    1: (0.0, None),
}


def _row(values: Mapping[str, float]) -> Array:
    """(F,) features as the model reads them; NaN for one that is missing."""
    found = np.array([values.get(name, np.nan) for name in READ])
    logarithmic = np.array([FEATURES[name].logarithmic for name in READ])
    return np.where(logarithmic, np.log1p(np.where(logarithmic, found, 0.0)), found)


def _within(standardised: NDArray[np.float64]) -> Array:
    known = np.where(np.isfinite(standardised), standardised, 0.0)
    return np.clip(known, -MOST_DEVIATIONS, MOST_DEVIATIONS)
