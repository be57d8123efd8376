"""Where bonnet, windscreen, roof and wheels lie: by class and box, fitted to LiDAR and outlines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from recast.actors.template.body import TemplateBody
from recast.arrays import Array

if TYPE_CHECKING:
    from recast.actors.template.placement import Contour


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
class Proportions:
    """Side-view landmarks of a body style.

    `*_x` are fractions of the length behind the front bumper, `*_z` fractions of the height above
    the ground; the others are metres for a body 1.75 m wide unless said otherwise.

    Attributes:
        bonnet_z: leading edge of the bonnet.
        cowl_x, cowl_z: base of the windscreen.
        roof_front_x, roof_rear_x, roof_rear_z: ends of the roof; its top is at 1.
        tail_x, tail_z: base of the rear window.
        deck_z: rear end of the boot lid, or of the shelf below the rear window.
        belt_rear_z: window sill at the rear; at the front it is `cowl_z`.
        front_axle_x, rear_axle_x: wheel centres.
        clearance_z: underside.
        wheel_radius: metres.
        tumblehome: how far each side window leans inward at the roof.
        nose_bow, tail_bow: how far the corners lie behind the middle of the bumper.
        nose_lean, tail_lean: how far the fascia leans back between bumper and bonnet or deck.
        edge_radius: rounding of the roof edges.
        rear_windows: whether there is side glass behind the front doors.
        side_pillars_x: pillars between side windows, B first.
        tail_lamp_z: lower and upper edge of the tail lamps.
        tail_lamp_inner: their inner end, as a fraction of the half width.
    """

    bonnet_z: float
    cowl_x: float
    cowl_z: float
    roof_front_x: float
    roof_rear_x: float
    roof_rear_z: float
    tail_x: float
    tail_z: float
    deck_z: float
    belt_rear_z: float
    front_axle_x: float
    rear_axle_x: float
    clearance_z: float
    wheel_radius: float
    tumblehome: float
    nose_bow: float
    tail_bow: float
    nose_lean: float
    tail_lean: float
    edge_radius: float
    rear_windows: bool
    side_pillars_x: tuple[float, ...]
    tail_lamp_z: tuple[float, float]
    tail_lamp_inner: float


# bonnet_z; cowl_x, _z; roof_front_x, roof_rear_x, _z; tail_x, _z; deck_z; belt_rear_z
_LANDMARKS = {
    "sedan": (0.50, 0.29, 0.665, 0.44, 0.67, 0.965, 0.835, 0.715, 0.67, 0.69),
    "hatchback": (0.49, 0.245, 0.645, 0.41, 0.855, 0.93, 0.955, 0.665, 0.62, 0.69),
    "estate": (0.50, 0.285, 0.66, 0.43, 0.875, 0.935, 0.975, 0.675, 0.65, 0.69),
    "mpv": (0.51, 0.185, 0.625, 0.355, 0.90, 0.955, 0.975, 0.62, 0.58, 0.66),
    "suv": (0.56, 0.265, 0.665, 0.395, 0.885, 0.955, 0.97, 0.655, 0.62, 0.69),
    "pickup": (0.56, 0.265, 0.66, 0.36, 0.565, 0.97, 0.595, 0.66, 0.60, 0.63),
    "van": (0.45, 0.13, 0.54, 0.27, 0.96, 0.985, 0.985, 0.55, 0.50, 0.56),
    "bus": (0.36, 0.012, 0.40, 0.03, 0.98, 0.99, 0.99, 0.52, 0.50, 0.44),
    "truck": (0.34, 0.02, 0.42, 0.06, 0.985, 0.995, 0.995, 0.45, 0.42, 0.43),
}
# front_axle_x, rear_axle_x; clearance_z, wheel_radius, tumblehome; nose_bow, tail_bow; nose_lean,
# tail_lean; edge_radius
_SHAPES = {
    "sedan": (0.185, 0.795, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.08, 0.14),
    "hatchback": (0.185, 0.81, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.04, 0.14),
    "estate": (0.185, 0.79, 0.13, 0.31, 0.17, 0.24, 0.14, 0.10, 0.04, 0.14),
    "mpv": (0.185, 0.82, 0.13, 0.31, 0.15, 0.24, 0.14, 0.14, 0.04, 0.14),
    "suv": (0.185, 0.795, 0.17, 0.36, 0.15, 0.24, 0.14, 0.06, 0.04, 0.14),
    "pickup": (0.185, 0.795, 0.18, 0.37, 0.13, 0.24, 0.05, 0.05, 0.04, 0.10),
    "van": (0.17, 0.77, 0.10, 0.34, 0.11, 0.24, 0.06, 0.20, 0.04, 0.14),
    "bus": (0.22, 0.72, 0.09, 0.48, 0.06, 0.14, 0.08, 0.02, 0.04, 0.12),
    "truck": (0.16, 0.76, 0.12, 0.48, 0.03, 0.10, 0.02, 0.02, 0.04, 0.07),
}
# rear_windows, side_pillars_x, tail_lamp_z, tail_lamp_inner
_WINDOWS: dict[str, tuple[bool, tuple[float, ...], tuple[float, float], float]] = {
    "sedan": (True, (0.515, 0.70), (0.49, 0.62), 0.60),
    "hatchback": (True, (0.51, 0.74), (0.49, 0.62), 0.60),
    "estate": (True, (0.505, 0.70), (0.49, 0.62), 0.60),
    "mpv": (True, (0.485, 0.73), (0.50, 0.76), 0.84),
    "suv": (True, (0.49, 0.71), (0.47, 0.66), 0.72),
    "pickup": (True, (0.46,), (0.38, 0.57), 0.84),
    "van": (False, (0.38,), (0.30, 0.50), 0.88),
    "bus": (True, (0.16, 0.30, 0.44, 0.58, 0.72, 0.86), (0.24, 0.42), 0.82),
    "truck": (False, (0.19,), (0.19, 0.25), 0.66),
}
STYLES = {
    style: Proportions(*_LANDMARKS[style], *_SHAPES[style], *_WINDOWS[style])
    for style in _LANDMARKS
}
"""Body styles, drawn by eye from side views of common cars."""

# Fitted to the evidence: those landmarks that a LiDAR cloud of one or two sides can tell.
FITTED = (
    "bonnet_z",
    "cowl_x",
    "cowl_z",
    "roof_front_x",
    "roof_rear_x",
    "roof_rear_z",
    "tail_x",
    "tail_z",
    "deck_z",
    "tumblehome",
    "tail_bow",
    "tail_lean",
)


def candidate_styles(category: str, size: ArrayLike) -> dict[str, float]:
    """Body styles a labelled vehicle may have, each with a prior cost (0 = most likely).

    Args:
        category: the track's class; everything that is not van, truck or bus counts as a car.
        size: (3,) length, width, height in metres.
    """
    length, _, height = np.asarray(size, np.float64)
    fixed = {"van": "van", "bus": "bus", "tram": "bus", "truck": "truck"}
    if category in fixed:
        return {fixed[category]: 0.0}
    # typical (length, height) of each style; the cost is the squared distance in units of spread
    typical = {
        "sedan": (4.65, 1.45),
        "hatchback": (4.0, 1.48),
        "estate": (4.6, 1.47),
        "mpv": (4.2, 1.63),
        "suv": (4.55, 1.70),
        "pickup": (5.4, 1.85),
    }
    costs = {
        style: ((length - usual[0]) / 0.4) ** 2 + ((height - usual[1]) / 0.12) ** 2
        for style, usual in typical.items()
    }
    least = min(costs.values())
    return {style: cost - least for style, cost in costs.items() if cost - least < 5.0}


@dataclass(frozen=True)
class ShapeFit:
    """A fitted body and where the real vehicle stands in its logged box.

    Attributes:
        style: name in `STYLES`.
        proportions: proportions of the style, bent to the points.
        offset: (2,) forward, left shift of the vehicle from the box, metres.
        scale: size of the vehicle over that of its box.
        median_distance: median distance of the points used to the fitted surface, metres; nan
            without points.
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
        category, size: see `candidate_styles`; the size (3,) is that of the logged box, metres.
        points: (N, 3) LiDAR points in the box frame, origin at its centre.
        style: take this one instead of choosing.
        contours: contours of the masks, see `contour`.
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
    deltas = zip(FITTED, solution, strict=False)
    changes: dict[str, Any] = {name: float(getattr(style, name) + delta) for name, delta in deltas}
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
        self._points = points[TemplateBody(size, style).wells(points) > -0.02]
        landmarks = [_SPREAD.get(name, _SPREAD_DEFAULT) for name in FITTED]
        self._spreads = np.array(
            [*landmarks, *_SHIFT_SPREAD, *[_VIEW_SPREAD] * (2 * len(contours))]
        )
        told = [(len(self._points), _EFFECTIVE, 0.0)]
        told += [(len(one.rays), _OUTLINE, one.noise) for one in contours]
        self._weights = np.concatenate([_shares(count, effective) for count, effective, _ in told])
        self._noise = np.concatenate([np.full(n, np.hypot(_NOISE, noise)) for n, _, noise in told])

    def solve(self) -> tuple[Array, float]:
        """The solution and its cost."""
        result = least_squares(
            self._residuals,
            np.zeros(len(self._spreads)),
            jac=self._slopes,
            bounds=(-2.5, 2.5),
            max_nfev=12,
            x_scale=1.0,
        )
        return result.x * self._spreads, float(np.sum(result.fun**2))

    def distance(self, solution: Array) -> Callable[[Array], Array]:
        """Distance in metres of points (N, 3) to the body as a solution bends and places it."""
        body = TemplateBody(self._size, _bent(self._style, solution))
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
