"""Choose a body style and bend it to the LiDAR points of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from recast.actors.template.body import Body
from recast.actors.template.proportions import FITTED, STYLES, Proportions, candidate_styles

Array = NDArray[np.float64]

_POINTS = 800
_NOISE = 0.04  # metres: LiDAR noise, label jitter and what the model cannot follow
_EFFECTIVE = 250.0  # independent measurements in a cloud, however many points it has
_SPREAD = {"tumblehome": 0.05, "tail_bow": 0.05, "tail_lean": 0.05}
_SPREAD_DEFAULT = 0.022
_SHIFT_SPREAD = np.array([0.10, 0.08, 0.03])  # label errors: along, across (metres), scale


@dataclass(frozen=True)
class ShapeFit:
    """A fitted body and where the real vehicle stands in its logged box.

    Attributes:
        style: name in `STYLES`.
        proportions: bent to the points.
        offset: (2,) forward, left shift of the vehicle from the box, metres.
        scale: size of the vehicle over that of its box.
        median_distance: of the points used to the fitted surface, metres; nan without points.
        costs: style to cost, for the record.
    """

    style: str
    proportions: Proportions
    offset: Array
    scale: float
    median_distance: float
    costs: dict[str, float]


def fit_shape(
    category: str,
    size: Array,
    points: NDArray[np.floating],
    rng: np.random.Generator,
    style: str | None = None,
) -> ShapeFit:
    """Fit every plausible style and keep the cheapest.

    Cost: robust (Cauchy) squared distances of the points to the implicit body, plus squared
    deviations from the style's landmarks and from the logged box, plus the style's prior.

    Args:
        category: class of the track.
        size: (3,) of the logged box, metres.
        points: (N, 3) LiDAR points in the box frame, origin at its centre.
        style: take this one instead of choosing.
    """
    priors = candidate_styles(category, size) if style is None else {style: 0.0}
    cloud = np.asarray(points, np.float64) + np.array([0.0, 0.0, size[2] / 2])
    if len(cloud) > _POINTS:
        cloud = cloud[np.sort(rng.choice(len(cloud), _POINTS, replace=False))]
    if len(cloud) == 0:
        chosen = min(priors, key=lambda name: priors[name])
        return ShapeFit(chosen, STYLES[chosen], np.zeros(2), 1.0, float("nan"), dict(priors))
    fits = {name: _fit_style(STYLES[name], size, cloud) for name in priors}
    costs = {name: cost + priors[name] for name, (_, cost) in fits.items()}
    chosen = min(costs, key=lambda name: costs[name])
    solution = fits[chosen][0]
    proportions = _bent(STYLES[chosen], solution)
    distance = _distances(size, proportions, solution, cloud)
    return ShapeFit(
        style=chosen,
        proportions=proportions,
        offset=solution[-3:-1].copy(),
        scale=float(1 + solution[-1]),
        median_distance=float(np.median(np.abs(distance))),
        costs=costs,
    )


def _spreads() -> Array:
    return np.array([*(_SPREAD.get(name, _SPREAD_DEFAULT) for name in FITTED), *_SHIFT_SPREAD])


def _bent(style: Proportions, solution: Array) -> Proportions:
    changes: dict[str, Any] = {
        name: float(getattr(style, name) + delta)
        for name, delta in zip(FITTED, solution[: len(FITTED)], strict=True)
    }
    return replace(style, **changes)


def _distances(size: Array, proportions: Proportions, solution: Array, points: Array) -> Array:
    forward, left, grow = solution[-3:]
    local = (points - [forward, left, 0.0]) / (1 + grow)
    body = Body(size, proportions)
    return body.distance(local) * (1 + grow)


def _fit_style(style: Proportions, size: Array, points: Array) -> tuple[Array, float]:
    spreads = _spreads()
    weight = np.sqrt(min(_EFFECTIVE, len(points)) / len(points))
    # points in the wheels are no part of the body
    body = Body(size, style)
    points = points[body.wells(points) > -0.02]

    def residuals(scaled: Array) -> Array:
        solution = scaled * spreads
        distance = _distances(size, _bent(style, solution), solution, points) / _NOISE
        robust = weight * np.sqrt(np.log1p(distance**2))
        return np.concatenate([robust, scaled])

    start = np.zeros(len(spreads))
    result = least_squares(
        residuals, start, bounds=(-2.5, 2.5), diff_step=1e-3, max_nfev=12, x_scale=1.0
    )
    return result.x * spreads, float(np.sum(result.fun**2))
