"""Where the photographed vehicle really stands and how large it is; and the outlines of its masks.

Labelled boxes are off by up to a decimetre in place and a tenth in size, which is many pixels
nearby. The mask and the LiDAR points tell better; colours are then read from the right pixels.

Each line of sight through an outline grazes the vehicle. How near it comes to the body is a
distance in metres like that of a LiDAR point, so masks and points are fitted together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import Observation
from recast.actors.place import minimum
from recast.actors.template.body import TemplateBody
from recast.actors.template.proportions import Proportions
from recast.actors.views import crossing
from recast.arrays import Array, Mask
from recast.geometry import se3

_NOISE = 0.04  # metres: as where the body is fitted
_SHIFT_SPREAD = np.array([0.12, 0.10, 0.05])  # metres along, across, up
_VIEW_SPREAD = 0.06  # metres across one view, as there
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
    """Affine map from the model (ground at z = 0) to the logged box's frame.

    Attributes:
        stretch: (3,) along, across, up.
        shift: (3,) metres.
        overlap: intersection over union of the model's silhouette with the mask.
    """

    stretch: Array
    shift: Array
    overlap: float

    def points(self, points: Array) -> Array:
        """Model points (N, 3) in the box frame."""
        return points * self.stretch + self.shift

    def normals(self, normals: Array) -> Array:
        """Unit normals (N, 3) after the map."""
        turned = normals / self.stretch
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
    outlines = [_Outline(view, surface, spacing) for view in observation.views]
    sizes = np.array([view.view.size_px for view in observation.views])
    shares = sizes**2 / np.sum(sizes**2)  # the finer a mask, the more its outline tells
    base = np.array([0.0, 0.0, -observation.size[2] / 2])

    def unpack(x: Array) -> tuple[Array, Array]:
        return 1 + x[3:] * _STRETCH_SPREAD, base + x[:3] * _SHIFT_SPREAD

    def cost(x: Array) -> float:
        stretch, shift = unpack(x)
        missed = np.dot(shares, [1 - one.overlap(stretch, shift) for one in outlines])
        total = _OVERLAP_WEIGHT * float(missed) + 0.5 * float(x @ x)
        if len(lidar):
            distance = body.distance((lidar - shift) / stretch)
            total += _LIDAR_WEIGHT * float(np.mean(np.log1p((distance / _NOISE) ** 2)))
        return total

    stretch, shift = unpack(minimum(cost, 6, 400, **_TOLERANCES))
    first = TemplatePlacement(stretch, shift, outlines[0].overlap(stretch, shift))
    return (first, *(one.placement(stretch, shift) for one in outlines[1:]))


class _Outline:
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

    def overlap(self, stretch: Array, shift: Array) -> float:
        """Intersection over union of the placed model's silhouette with the mask."""
        placed = se3.apply(self._view.camera_from_object, self._surface * stretch + shift)
        pixels, _ = self._view.camera.project(placed)
        return overlap(silhouette(pixels / self._cell, self._mask.shape), self._mask)

    def placement(self, stretch: Array, shift: Array) -> TemplatePlacement:
        """The model shifted further across this view, to the right and down in the image."""
        across = self._view.camera_from_object[:2, :3]

        def cost(x: Array) -> float:
            moved = shift + _VIEW_SPREAD * x @ across
            return _VIEW_OVERLAP_WEIGHT * (1 - self.overlap(stretch, moved)) + 0.5 * float(x @ x)

        shift = shift + _VIEW_SPREAD * minimum(cost, 2, 60, **_TOLERANCES) @ across
        return TemplatePlacement(stretch, shift, self.overlap(stretch, shift))


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
    body: TemplateBody, observation: Observation, placements: Sequence[TemplatePlacement]
) -> Proportions:
    """Proportions with the axles where the photographs show wheels.

    A wheel is a bright rim in a dark tyre: the place along the side, within 0.07 lengths of the
    usual one, where rim and tyre differ most, in the view that shows it most clearly. Unclear or
    hidden wheels keep their place.
    """
    found: dict[str, Any] = {}
    for name in ("front_axle_x", "rear_axle_x"):
        usual = getattr(body.proportions, name)
        seen = [
            _clearest(body, view, placement, usual)
            for view, placement in zip(observation.views, placements, strict=True)
        ]
        contrast, place = max(seen)
        found[name] = place if contrast > 0.8 else usual
    return replace(body.proportions, **found)


def _clearest(
    body: TemplateBody, view: Observation, placement: TemplatePlacement, usual: float
) -> tuple[float, float]:
    """Contrast of rim and tyre where one view shows a wheel best, and where: see `find_axles`."""
    side = np.sign(view.eye[1])
    eye_across = abs(view.eye[1]) - view.size[1] / 2
    if eye_across / np.linalg.norm(view.eye) < 0.15:
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
    return float(scores[best]), float(candidates[best])


@dataclass(frozen=True)
class Contour:
    """The outline of one mask as M lines of sight, in the box frame with the ground at z = 0.

    Attributes:
        eye: (3,) position of the camera.
        rays: (M, 3) unit directions.
        near, far: (M,) metres along each line between which the body may be.
        across: (2, 3) unit vectors to the right and down in the image.
        noise: metres by which a line is off.
    """

    eye: Array
    rays: Array
    near: Array
    far: Array
    across: Array
    noise: float

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
