"""Lines of sight through the outline of a mask: each of them grazes the vehicle.

How near a line comes to the body is a distance in metres like that of a LiDAR point, so masks and
points are fitted together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import Observation

Array = NDArray[np.float64]

_LINES = 48  # about a view's outline; neighbours tell the same
_FROM_BORDER = 2  # pixels: where the crop ends, the outline is not the vehicle's
_LOWEST = 0.4  # of the height: below it are wheels and shadow
_AROUND = 0.25  # metres around the box within which the body is looked for
_COARSE, _FINE = 24, 9  # steps along a line
_PIXELS = 1.5  # by which masks are off


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
    step = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    half = np.array([*size[:2] / 2, size[2]]) + _AROUND
    low = np.array([-half[0], -half[1], 0.0])
    first, last = (low - eye) / step, (half - eye) / step
    return np.minimum(first, last).max(axis=1), np.maximum(first, last).min(axis=1)
