"""Choose a body style and bend it to the LiDAR points of the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from recast.actors.template.body import Body
from recast.actors.template.contours import Contour
from recast.actors.template.proportions import FITTED, STYLES, Proportions, candidate_styles

Array = NDArray[np.float64]

_POINTS = 800
_NOISE = 0.04  # metres: LiDAR noise, label jitter and what the model cannot follow
_EFFECTIVE = 250.0  # independent measurements in a cloud, however many points it has
_OUTLINE = 24.0  # and in the outline of a mask
_VIEW_SPREAD = 0.06  # metres by which a label is off in one frame, across the view
_STEP = 0.05  # of the spreads, for slopes
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
    contours: Sequence[Contour] = (),
) -> ShapeFit:
    """Fit every plausible style and keep the cheapest.

    Cost: robust (Cauchy) squared distances of the points and of the lines of sight along the masks'
    outlines to the implicit body, plus squared deviations from the style's landmarks and from the
    logged box, plus the style's prior.

    Args:
        category: class of the track.
        size: (3,) of the logged box, metres.
        points: (N, 3) LiDAR points in the box frame, origin at its centre.
        style: take this one instead of choosing.
        contours: of the masks, see `contour`.
    """
    priors = candidate_styles(category, size) if style is None else {style: 0.0}
    cloud = np.asarray(points, np.float64) + np.array([0.0, 0.0, size[2] / 2])
    if len(cloud) > _POINTS:
        cloud = cloud[np.sort(rng.choice(len(cloud), _POINTS, replace=False))]
    contours = [one for one in contours if len(one.rays)]
    if len(cloud) == 0 and not contours:
        chosen = min(priors, key=lambda name: priors[name])
        return ShapeFit(chosen, STYLES[chosen], np.zeros(2), 1.0, float("nan"), dict(priors))
    fits = {name: _Problem(STYLES[name], size, cloud, contours).solve() for name in priors}
    costs = {name: cost + priors[name] for name, (_, cost) in fits.items()}
    chosen = min(costs, key=lambda name: costs[name])
    solution = fits[chosen][0]
    distance = _Problem(STYLES[chosen], size, cloud, contours).distance(solution)(cloud)
    place = solution[len(FITTED) :]
    return ShapeFit(
        style=chosen,
        proportions=_bent(STYLES[chosen], solution),
        offset=place[:2].copy(),
        scale=float(1 + place[2]),
        median_distance=float(np.median(np.abs(distance))) if len(cloud) else float("nan"),
        costs=costs,
    )


def _bent(style: Proportions, solution: Array) -> Proportions:
    changes: dict[str, Any] = {
        name: float(getattr(style, name) + delta)
        for name, delta in zip(FITTED, solution, strict=False)
    }
    return replace(style, **changes)


class _Problem:
    """Least squares of one style: landmarks, place in the box, and a shift of each mask.

    Args:
        points: (N, 3), z up from the ground; those in the wheels are no part of the body.
    """

    def __init__(
        self, style: Proportions, size: Array, points: Array, contours: Sequence[Contour]
    ) -> None:
        self._style, self._size, self._contours = style, size, contours
        self._points = points[Body(size, style).wells(points) > -0.02]
        landmarks = [_SPREAD.get(name, _SPREAD_DEFAULT) for name in FITTED]
        self._spreads = np.array(
            [*landmarks, *_SHIFT_SPREAD, *[_VIEW_SPREAD] * (2 * len(contours))]
        )
        self._weights = np.concatenate(
            [
                _shares(len(self._points), _EFFECTIVE),
                *(_shares(len(c.rays), _OUTLINE) for c in contours),
            ]
        )
        self._noise = np.concatenate(
            [np.full(len(self._points), _NOISE)]
            + [np.full(len(c.rays), np.hypot(_NOISE, c.noise)) for c in contours]
        )

    def solve(self) -> tuple[Array, float]:
        """The solution and its cost."""
        result = least_squares(
            self._residuals, np.zeros(len(self._spreads)), jac=self._slopes, bounds=(-2.5, 2.5),
            max_nfev=12, x_scale=1.0,
        )  # fmt: skip
        return result.x * self._spreads, float(np.sum(result.fun**2))

    def distance(self, solution: Array) -> Callable[[Array], Array]:
        """Distance in metres of points (N, 3) to the body as a solution bends and places it."""
        body = Body(self._size, _bent(self._style, solution))
        forward, left, grow = solution[len(FITTED) : len(FITTED) + 3]
        return lambda points: (
            body.distance((points - [forward, left, 0.0]) / (1 + grow)) * (1 + grow)
        )

    def _nearest(self, scaled: Array) -> list[Array]:
        solution = scaled * self._spreads
        distance, shifts = self.distance(solution), self._shifts(solution)
        return [
            one.nearest(distance, shift) for one, shift in zip(self._contours, shifts, strict=True)
        ]

    def _shifts(self, solution: Array) -> Array:
        return solution[len(FITTED) + 3 :].reshape(-1, 2)

    def _residuals(self, scaled: Array, along: list[Array] | None = None) -> Array:
        """Of points, lines and prior; `along` says where the lines are looked at."""
        solution = scaled * self._spreads
        along = self._nearest(scaled) if along is None else along
        seen = [
            one.points(where, shift)
            for one, where, shift in zip(self._contours, along, self._shifts(solution), strict=True)
        ]
        distance = self.distance(solution)(np.concatenate([self._points, *seen])) / self._noise
        return np.concatenate([self._weights * np.sqrt(np.log1p(distance**2)), scaled])

    def _slopes(self, scaled: Array) -> Array:
        """Forward differences; where a line comes nearest is held, which changes no derivative."""
        along = self._nearest(scaled)
        here = self._residuals(scaled, along)
        steps = _STEP * np.eye(len(scaled))
        return np.stack(
            [(self._residuals(scaled + one, along) - here) / _STEP for one in steps], -1
        )


def _shares(count: int, effective: float) -> Array:
    """Weights (count,) of measurements of which only so many are independent."""
    return np.full(count, np.sqrt(min(effective, count) / max(count, 1)))
