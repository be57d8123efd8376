"""Where the photographed vehicle really stands and how large it is, against its logged box.

Labelled boxes are off by up to a decimetre in place and a tenth in size, which is many pixels
nearby. The mask and the LiDAR points tell better; colours are then read from the right pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from recast.actors.observation import Observation
from recast.actors.template.body import Body
from recast.actors.template.proportions import Proportions
from recast.geometry import se3

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NOISE = 0.04  # metres, see fit.py
_SHIFT_SPREAD = np.array([0.12, 0.10, 0.05])  # metres along, across, up
_STRETCH_SPREAD = np.array([0.06, 0.07, 0.04])
_OVERLAP_WEIGHT = 60.0
_LIDAR_WEIGHT = 3.0


@dataclass(frozen=True)
class Placement:
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
    body: Body, surface: Array, spacing: float, observation: Observation, lidar: Array
) -> Placement:
    """Move and stretch the model onto mask and LiDAR points, with the logged box as prior.

    Args:
        body: the model.
        surface: (N, 3) points on it and its wheels, ground at z = 0.
        spacing: metres between them.
        observation: mask, camera and box.
        lidar: (M, 3) points in the box frame.
    """
    mask = observation.rgba[..., 3] > 127
    # coarser than the points, or the silhouette has holes
    pixels_per_metre = observation.camera.fx / np.linalg.norm(observation.eye)
    cell = max(1, round(0.9 * spacing * pixels_per_metre))
    shape = (mask.shape[0] // cell, mask.shape[1] // cell)
    small = cv2.resize(mask.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA) > 0.5
    base = np.array([0.0, 0.0, -observation.size[2] / 2])

    def unpack(x: Array) -> tuple[Array, Array]:
        return 1 + x[3:] * _STRETCH_SPREAD, base + x[:3] * _SHIFT_SPREAD

    def cost(x: Array) -> float:
        stretch, shift = unpack(x)
        pixels, _ = observation.camera.project(
            se3.apply(observation.camera_from_object, surface * stretch + shift)
        )
        drawn = silhouette(pixels / cell, shape)
        total = _OVERLAP_WEIGHT * (1 - overlap(drawn, small)) + 0.5 * float(x @ x)
        if len(lidar):
            distance = body.distance((lidar - shift) / stretch)
            total += _LIDAR_WEIGHT * float(np.mean(np.log1p((distance / _NOISE) ** 2)))
        return total

    simplex = np.concatenate([np.zeros((1, 6)), 0.6 * np.eye(6)])
    result = minimize(
        cost, np.zeros(6), method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 400, "xatol": 0.02, "fatol": 0.01},
    )  # fmt: skip
    stretch, shift = unpack(result.x)
    pixels, _ = observation.camera.project(
        se3.apply(observation.camera_from_object, surface * stretch + shift)
    )
    return Placement(stretch, shift, overlap(silhouette(pixels / cell, shape), small))


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


def find_axles(body: Body, observation: Observation, placement: Placement) -> Proportions:
    """Proportions with the axles where the photograph shows wheels on the side it sees.

    A wheel is a bright rim in a dark tyre: the place along the side, within 0.07 lengths of the
    usual one, where rim and tyre differ most. Unclear or hidden wheels keep their place.
    """
    side = np.sign(observation.eye[1])
    eye_across = abs(observation.eye[1]) - observation.size[1] / 2
    if eye_across / np.linalg.norm(observation.eye) < 0.15:
        return body.proportions
    grey = cv2.cvtColor(observation.rgba[..., :3], cv2.COLOR_RGB2GRAY).astype(np.float32)
    angle, radius = np.meshgrid(
        np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(0.1, 0.97, 14)
    )
    rim, tyre = radius.ravel() < 0.62, radius.ravel() > 0.76
    found: dict[str, Any] = {}
    for name in ("front_axle_x", "rear_axle_x"):
        usual = getattr(body.proportions, name)
        candidates = usual + np.linspace(-0.07, 0.07, 29)
        scores = []
        for fraction in candidates:
            disc = np.stack(
                [body.x_at(fraction) + body.wheel_radius * (radius * np.cos(angle)).ravel(),
                 np.full(radius.size, side * body.width / 2),
                 body.wheel_radius * (1 + (radius * np.sin(angle)).ravel())], -1
            )  # fmt: skip
            pixels, _ = observation.camera.project(
                se3.apply(observation.camera_from_object, placement.points(disc))
            )
            u, v = (pixels - 0.5).astype(np.float32).T
            values = cv2.remap(grey, u[None], v[None], cv2.INTER_LINEAR)[0]
            contrast = values[rim].mean() - values[tyre].mean()
            scores.append(
                contrast / (values[tyre].std() + 12.0) - 0.3 * abs(fraction - usual) / 0.07
            )
        best = int(np.argmax(scores))
        found[name] = float(candidates[best]) if scores[best] > 0.8 else usual
    return replace(body.proportions, **found)
