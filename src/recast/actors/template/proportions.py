"""The design of a vehicle fitted to LiDAR and outlines; the vehicle placed in its photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from recast.actors.observation import Observation, crossing
from recast.actors.place import minimum
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import ramp
from recast.actors.template.design import VehicleDesign, candidate_styles, likely_design
from recast.arrays import Array, Mask
from recast.geometry import se3

_POINTS = 800
_NOISE = 0.04  # metres: LiDAR noise, label jitter and what the model cannot follow
_EFFECTIVE = 250.0  # independent measurements in a cloud, however many points it has
_OUTLINE = 24.0  # and in the outline of a mask
_VIEW_SPREAD = 0.06  # metres by which a label is off in one frame, across the view
_STEP = 0.05  # of the spreads, for slopes
_SPREAD = {"tumblehome": 0.05, "tail_bow": 0.05, "tail_lean": 0.05}
_SPREAD_DEFAULT = 0.022
_SHIFT_SPREAD = np.array([0.10, 0.08, 0.03])  # label errors: along, across (metres), scale


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


@dataclass(frozen=True)
class ShapeFit:
    """A fitted body and where the real vehicle stands in its logged box."""

    style: str  # name in `STYLES`
    design: VehicleDesign  # design of the style, bent to the points
    offset: Array  # (2,) forward, left shift of the vehicle from the box, metres
    scale: float  # size of the vehicle over that of its box
    # median distance of the points used to the fitted surface, metres; nan without points.
    median_distance: float
    cost: float  # cost of LiDAR, outlines and priors, in halves of nats


def fit_shapes(
    category: str,
    size: Array,
    points: NDArray[np.floating],
    rng: np.random.Generator,
    style: str | None = None,
    contours: Sequence[Contour] = (),
) -> list[ShapeFit]:
    """Fit every plausible style, the cheapest first.

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
    fits = []
    for name, prior in priors.items():
        design = likely_design(name, size)
        solution, cost = np.zeros(len(FITTED) + 3), 0.0
        problem = _Problem(design, size, cloud, contours)
        if len(cloud) or contours:
            solution, cost = problem.solve()
        distance = problem.distance(solution)(cloud)
        fits.append(
            ShapeFit(
                style=name,
                design=_bent(design, solution),
                offset=solution[len(FITTED) :][:2].copy(),
                scale=float(1 + solution[len(FITTED) + 2]),
                median_distance=float(np.median(np.abs(distance))) if len(cloud) else float("nan"),
                cost=cost + prior,
            )
        )
    return sorted(fits, key=lambda fit: fit.cost)


def _bent(style: VehicleDesign, solution: Array) -> VehicleDesign:
    usual = style.proportions
    deltas = zip(FITTED, solution, strict=False)
    changes: dict[str, Any] = {name: float(getattr(usual, name) + delta) for name, delta in deltas}
    return replace(style, proportions=replace(usual, **changes))


class _Problem:
    """Least squares of one style: landmarks, place in the box, and a shift of each mask.

    Args:
        points: (N, 3), z up from the ground; those in the wheels are no part of the body.
    """

    def __init__(
        self, style: VehicleDesign, size: Array, points: Array, contours: Sequence[Contour]
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
        """Residuals of points, lines and prior; `along` says where the lines are looked at."""
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


# Where the photographed vehicle really stands and how large it is; and the outlines of its masks.
#
# Labelled boxes are off by up to a decimetre in place and a tenth in size, which is many pixels
# nearby. The mask and the LiDAR points tell better; colours are then read from the right pixels.
#
# Each line of sight through an outline grazes the vehicle. How near it comes to the body is a
# distance in metres like that of a LiDAR point, so masks and points are fitted together.

_PLACE_SPREAD = np.array([0.12, 0.10, 0.05])  # metres along, across, up
_STRETCH_SPREAD = np.array([0.06, 0.07, 0.04])
_OVERLAP_WEIGHT = 60.0
_VIEW_OVERLAP_WEIGHT = 10.0  # masks are off by more than the last centimetres would gain
_LIDAR_WEIGHT = 3.0
_LINES = 48  # about a view's outline; neighbours tell the same
_FROM_BORDER = 2  # pixels: where the crop ends, the outline is not the vehicle's
_LOWEST = 0.4  # of the height: below it are wheels and shadow
_AROUND = 0.25  # metres around the box within which the body is looked for
_COARSE, _FINE = 24, 9  # steps along a line
_PIXELS = 1.5  # by which masks are off
_TOLERANCES = {"xatol": 0.02, "fatol": 0.01}


@dataclass(frozen=True)
class TemplatePlacement:
    """Affine map from the model (ground at z = 0) to the logged box's frame."""

    stretch: Array  # (3,) along, across, up
    shift: Array  # (3,) metres
    overlap: float = 0.0  # intersection over union of the model's silhouette with the mask
    yaw: float = 0.0  # turn about the vertical after the stretch, radians

    def points(self, points: Array) -> Array:
        """Model points (N, 3) in the box frame."""
        return (points * self.stretch) @ se3.rotation_z(self.yaw).T + self.shift

    def normals(self, normals: Array) -> Array:
        """Unit normals (N, 3) after the map."""
        turned = (normals / self.stretch) @ se3.rotation_z(self.yaw).T
        return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def place(
    body: TemplateBody, surface: Array, spacing: float, observation: Observation, lidar: Array
) -> tuple[TemplatePlacement, ...]:
    """Move and stretch the model onto masks and LiDAR points, with the logged box as prior.

    The stretch is that of the vehicle. Labels are off differently in every frame, so each further
    of the observation's views has a shift of its own across the view.

    Args:
        surface: (N, 3) points on the body and its wheels, ground at z = 0.
        spacing: metres between them.
        observation: masks, cameras and box.
        lidar: (M, 3) points in the box frame.

    Returns:
        The placement for each of the observation's views.
    """
    outlines = [Silhouette(view, surface, spacing) for view in observation.views]
    sizes = np.array([view.view.size_px for view in observation.views])
    shares = sizes**2 / np.sum(sizes**2)  # the finer a mask, the more its outline tells
    base = np.array([0.0, 0.0, -observation.size[2] / 2])

    def unpack(x: Array) -> tuple[Array, Array]:
        return 1 + x[3:] * _STRETCH_SPREAD, base + x[:3] * _PLACE_SPREAD

    def cost(x: Array) -> float:
        stretch, shift = unpack(x)
        placed = TemplatePlacement(stretch, shift)
        missed = np.dot(shares, [1 - one.overlap(placed) for one in outlines])
        total = _OVERLAP_WEIGHT * float(missed) + 0.5 * float(x @ x)
        if len(lidar):
            distance = body.distance((lidar - shift) / stretch)
            total += _LIDAR_WEIGHT * float(np.mean(np.log1p((distance / _NOISE) ** 2)))
        return total

    stretch, shift = unpack(minimum(cost, 6, 400, **_TOLERANCES))
    first = outlines[0].judged(TemplatePlacement(stretch, shift))
    return (first, *(one.placement(stretch, shift) for one in outlines[1:]))


class Silhouette:
    """The silhouette of the model against the mask of one view."""

    def __init__(self, view: Observation, surface: Array, spacing: float) -> None:
        self._view, self._surface = view, surface
        mask = view.rgba[..., 3] > 127
        # coarser than the points, or the silhouette has holes
        pixels_per_metre = view.camera.fx / np.linalg.norm(view.eye)
        self._cell = max(1, round(0.9 * spacing * pixels_per_metre))
        shape = (mask.shape[0] // self._cell, mask.shape[1] // self._cell)
        area = cv2.resize(mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
        self._mask: Mask = area > 0.5

    def overlap(self, placement: TemplatePlacement) -> float:
        """Intersection over union of the placed model's silhouette with the mask."""
        placed = se3.apply(self._view.camera_from_object, placement.points(self._surface))
        pixels, _ = self._view.camera.project(placed)
        return overlap(silhouette(pixels / self._cell, self._mask.shape), self._mask)

    def placement(self, stretch: Array, shift: Array) -> TemplatePlacement:
        """The model shifted further across this view, to the right and down in the image."""
        across = self._view.camera_from_object[:2, :3]

        def cost(x: Array) -> float:
            moved = shift + _VIEW_SPREAD * x @ across
            placed = TemplatePlacement(stretch, moved)
            return _VIEW_OVERLAP_WEIGHT * (1 - self.overlap(placed)) + 0.5 * float(x @ x)

        shift = shift + _VIEW_SPREAD * minimum(cost, 2, 60, **_TOLERANCES) @ across
        return self.judged(TemplatePlacement(stretch, shift))

    def judged(self, placement: TemplatePlacement) -> TemplatePlacement:
        """The placement with its overlap."""
        return replace(placement, overlap=self.overlap(placement))


def silhouette(pixels: Array, shape: tuple[int, int]) -> Mask:
    """Filled outline (H, W) of a dense cloud of projected surface points (N, 2)."""
    mask = np.zeros(shape, np.uint8)
    u, v = np.floor(pixels).astype(int).T
    inside = (u >= 0) & (u < shape[1]) & (v >= 0) & (v < shape[0])
    mask[v[inside], u[inside]] = 1
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0


def overlap(first: Mask, second: Mask) -> float:
    """Intersection over union."""
    return float((first & second).sum() / max(int((first | second).sum()), 1))


def find_axles(
    body: TemplateBody,
    usual: VehicleDesign,
    observation: Observation,
    placements: Sequence[TemplatePlacement],
) -> VehicleDesign:
    """The body's design with the axles where the photographs show wheels.

    A wheel is a bright rim in a dark tyre: the place along the side, within 0.07 lengths of the
    usual one, where rim and tyre differ most. A view counts the more, the more squarely it shows
    the side, and only if the contrast falls to both sides of the best place: a wheel that is seen
    from ahead is a dark bar anywhere. Unclear or hidden wheels keep their place.
    """
    found: dict[str, Any] = {}
    for name in ("front_axle_x", "rear_axle_x"):
        expected = getattr(usual.proportions, name)
        seen = [
            _clearest(body, view, placement, expected)
            for view, placement in zip(observation.views, placements, strict=True)
        ]
        contrast, place = max(seen)
        found[name] = place if contrast > _CLEAR_WHEEL else expected
    return replace(body.design, proportions=replace(body.design.proportions, **found))


_CLEAR_WHEEL = 0.8  # contrast of rim and tyre, in deviations within the tyre
_SQUARE = 0.15, 0.45  # sine of the angle to the side: from hardly seen to seen well


def _clearest(
    body: TemplateBody, view: Observation, placement: TemplatePlacement, usual: float
) -> tuple[float, float]:
    """Contrast of rim and tyre where one view shows a wheel best, and where: see `find_axles`."""
    side = np.sign(view.eye[1])
    squareness = (abs(view.eye[1]) - view.size[1] / 2) / np.linalg.norm(view.eye)
    trust = float(ramp(np.array(squareness), *_SQUARE))
    if trust == 0:
        return 0.0, usual
    grey = cv2.cvtColor(view.rgba[..., :3], cv2.COLOR_RGB2GRAY).astype(np.float32)
    angle, radius = np.meshgrid(
        np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(0.1, 0.97, 14)
    )
    rim, tyre = radius.ravel() < 0.62, radius.ravel() > 0.76
    candidates = usual + np.linspace(-0.07, 0.07, 29)
    scores = []
    for fraction in candidates:
        disc = np.stack(
            [
                body.x_at(fraction) + body.wheel_radius * (radius * np.cos(angle)).ravel(),
                np.full(radius.size, side * body.width / 2),
                body.wheel_radius * (1 + (radius * np.sin(angle)).ravel()),
            ],
            -1,
        )
        pixels, _ = view.camera.project(se3.apply(view.camera_from_object, placement.points(disc)))
        u, v = (pixels - 0.5).astype(np.float32).T
        values = cv2.remap(grey, u[None], v[None], cv2.INTER_LINEAR)[0]
        contrast = values[rim].mean() - values[tyre].mean()
        scores.append(contrast / (values[tyre].std() + 12.0) - 0.3 * abs(fraction - usual) / 0.07)
    best = int(np.argmax(scores))
    if best in (0, len(candidates) - 1):  # still rising: no wheel is centred there
        return 0.0, usual
    return trust * float(scores[best]), float(candidates[best])


@dataclass(frozen=True)
class Contour:
    """The outline of one mask as M lines of sight, in the box frame with the ground at z = 0."""

    eye: Array  # (3,) position of the camera
    rays: Array  # (M, 3) unit directions
    # near, far: (M,) metres along each line between which the body may be.
    near: Array
    far: Array
    across: Array  # (2, 3) unit vectors to the right and down in the image
    noise: float  # metres by which a line is off

    def points(self, along: Array, shift: Array) -> Array:
        """(..., M, 3) at distances (..., M), all moved by `shift` (2,) metres across the view."""
        return self.eye + shift @ self.across + along[..., None] * self.rays

    def nearest(self, distance: Callable[[Array], Array], shift: Array) -> Array:
        """Distances along the lines (M,) at which they come nearest to a body, or enter deepest."""
        low, high = self.near, self.far
        for steps in (_COARSE, _FINE):
            along = low + np.linspace(0.0, 1.0, steps)[:, None] * (high - low)
            values = distance(self.points(along, shift).reshape(-1, 3)).reshape(along.shape)
            best = np.take_along_axis(along, np.argmin(values, axis=0)[None], axis=0)[0]
            step = (high - low) / (steps - 1)
            low, high = best - step, best + step
        return best


def contour(observation: Observation) -> Contour:
    """The upper part of the outline of an observation's mask, without what the crop cuts off."""
    pixels = _border(observation.rgba[..., 3] > 127)
    size = np.array([observation.camera.width, observation.camera.height])
    pixels = pixels[np.all((pixels > _FROM_BORDER) & (pixels < size - _FROM_BORDER), axis=1)]
    pixels = pixels[np.linspace(0, len(pixels), _LINES, endpoint=False).astype(int)[: len(pixels)]]
    rotation = observation.camera_from_object[:3, :3]
    rays = observation.camera.rays(pixels) @ rotation
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    eye = observation.eye + np.array([0.0, 0.0, observation.size[2] / 2])
    near, far = _crossing(eye, rays, observation.size)
    height = eye[2] + (near + far) / 2 * rays[:, 2]
    kept = (near < far) & (near > 0) & (height > _LOWEST * observation.size[2])
    metres_per_pixel = float(np.linalg.norm(observation.eye)) / observation.camera.fx
    return Contour(eye, rays[kept], near[kept], far[kept], rotation[:2], _PIXELS * metres_per_pixel)


def _border(mask: NDArray[np.bool_]) -> Array:
    """Places (N, 2) between pixels in and out of a mask (H, W), in order around its middle."""
    beside, below = (np.argwhere(np.diff(mask, axis=axis)) for axis in (1, 0))
    places = np.concatenate([beside[:, ::-1] + [1.0, 0.5], below[:, ::-1] + [0.5, 1.0]])
    if len(places) == 0:  # the mask fills the crop
        return places
    x, y = (places - places.mean(axis=0)).T
    return places[np.argsort(np.arctan2(y, x), kind="stable")]


def _crossing(eye: Array, rays: Array, size: Array) -> tuple[Array, Array]:
    """Where lines (M, 3) from `eye` enter and leave the grown box on the ground, metres (M,)."""
    high = np.array([*size[:2] / 2, size[2]]) + _AROUND
    return crossing(eye, rays, high * [-1, -1, 0], high)
