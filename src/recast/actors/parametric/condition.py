"""What the parametric model sees: the crop unwrapped onto the sides of the box, and its geometry.

The camera and the box are known, so every pixel of a side, a front and a rear view is looked up in
the crop. A lamp then lies at the same pixels in all photographs, near or far, from left or right,
and a small network can read it. Vehicles are symmetric: one seen from its right is mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import Observation
from recast.actors.template.lighting import road_level, road_light, road_tint
from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.geometry import boxes, se3

SHAPES = {"side": (32, 96), "rear": (32, 48), "front": (32, 48), "crop": (48, 48)}
"""Rows and columns of each plane; `crop` is the photograph itself around the box."""
CHANNELS = 5
"""Colour within the mask, mask, and whether the plane is seen."""
CATEGORIES = ("car", "van", "truck", "bus")
GEOMETRY = 16 + len(CATEGORIES)
_AROUND = 1.08  # the planes reach beyond the box, whose labels are off
_FINEST = 30.0  # pixels a metre of the crop that planes are looked up in
_SEEN = 0.35  # cosine to a plane above which it counts as seen squarely


@dataclass(frozen=True)
class ConditionImages:
    """One photograph as the network takes it."""

    planes: NDArray[np.uint8]  # (pixels of all `SHAPES`, 5)
    geometry: NDArray[np.float32]  # (GEOMETRY,)


def condition_of(observation: Observation) -> ConditionImages:
    """The condition of an observation, its further views left out."""
    return unwrapped(
        observation.rgba,
        observation.camera,
        observation.camera_from_object,
        observation.size,
        observation.category,
        road_light(replace(observation, further=())),
    )


def unwrapped(
    rgba: Image,
    camera: PinholeCamera,
    camera_from_object: Array,
    size: Array,
    category: str,
    road: Array,
) -> ConditionImages:
    """Look the planes up in a photograph.

    Args:
        rgba: (H, W, 4) uint8.
        camera, camera_from_object, size, category: see `Observation`.
        road: (3,) linear light of the road, see `road_light`.
    """
    size = np.asarray(size, np.float64)
    depth = float(np.linalg.norm(camera_from_object[:3, 3]))
    scale = min(1.0, _FINEST * depth / camera.fx)
    if scale < 0.9:
        width, height = (max(8, round(scale * v)) for v in (camera.width, camera.height))
        camera = camera.resized(width, height)
        alpha = cv2.resize(rgba[..., 3], (width, height), interpolation=cv2.INTER_AREA)
        colour = cv2.resize(rgba[..., :3], (width, height), interpolation=cv2.INTER_AREA)
        rgba = np.dstack([colour, alpha])
    rotation, translation = camera_from_object[:3, :3], camera_from_object[:3, 3]
    eye = -rotation.T @ translation
    right = 1.0 if eye[1] >= 0 else -1.0  # of two mirror images, that with the eye on the left
    images = [
        _looked_up(rgba, camera, camera_from_object, _plane(name, size, right), cosine)
        for name, cosine in zip(("side", "rear", "front"), _facing(size, eye), strict=True)
    ]
    images.append(_around(rgba, camera, camera_from_object, size, right))
    planes = np.concatenate([image.reshape(-1, CHANNELS) for image in images])
    return ConditionImages(planes, _geometry(size, eye, camera.fx / scale, category, road))


def _facing(size: Array, eye: Array) -> tuple[float, float, float]:
    """Cosines between the way out of side, rear and front and the way to the eye."""
    away = [np.abs(eye[1]) - size[1] / 2, -eye[0] - size[0] / 2, eye[0] - size[0] / 2]
    return tuple(float(v / np.linalg.norm(eye)) for v in away)  # type: ignore[return-value]


def _plane(name: str, size: Array, right: float) -> Array:
    """Points (rows, columns, 3) of a plane in the object frame, the first row on top."""
    rows, columns = SHAPES[name]
    v, u = np.meshgrid(
        np.linspace(1, -1, rows) * _AROUND, np.linspace(1, -1, columns) * _AROUND, indexing="ij"
    )
    half = size / 2
    if name == "side":
        return np.stack([u * half[0], np.full_like(u, right * half[1]), v * half[2]], axis=-1)
    end = half[0] if name == "front" else -half[0]
    return np.stack([np.full_like(u, end), right * u * half[1], v * half[2]], axis=-1)


def _looked_up(
    rgba: Image, camera: PinholeCamera, camera_from_object: Array, points: Array, cosine: float
) -> Image:
    """(rows, columns, 5) of a plane."""
    flat = se3.apply(camera_from_object, points.reshape(-1, 3))
    pixels, depth = camera.project(flat)
    seen = (depth > 0.2) & np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    squarely = np.clip(cosine / _SEEN, 0.0, 1.0) * seen
    return _sampled(rgba, pixels, squarely).reshape(*points.shape[:2], CHANNELS)


def _around(
    rgba: Image, camera: PinholeCamera, camera_from_object: Array, size: Array, right: float
) -> Image:
    """(rows, columns, 5) of the square around the box in the photograph."""
    rows, columns = SHAPES["crop"]
    corners, _ = camera.project(boxes.corners(size, camera_from_object))
    low, high = corners.min(axis=0), corners.max(axis=0)
    edge = float(np.clip(_AROUND * (high - low).max(), 4.0, 1e5))
    middle = (low + high) / 2
    v, u = np.meshgrid(
        np.linspace(-0.5, 0.5, rows), right * np.linspace(-0.5, 0.5, columns), indexing="ij"
    )
    pixels = (middle + edge * np.stack([u, v], axis=-1)).reshape(-1, 2)
    seen = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    return _sampled(rgba, pixels, seen.astype(np.float64)).reshape(rows, columns, CHANNELS)


def _sampled(rgba: Image, pixels: Array, seen: Array) -> Image:
    """Bilinear values (N, 5) at pixels (N, 2): colour where the mask is, black elsewhere."""
    u, v = np.clip(pixels - 0.5, -1e4, 1e4).astype(np.float32).T
    found = cv2.remap(rgba, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(found[0], np.uint8)
    values[:, 3][seen == 0] = 0
    values[:, :3][values[:, 3] < 128] = 0
    return np.concatenate([values, np.round(255 * seen)[:, None].astype(np.uint8)], axis=1)


def _geometry(
    size: Array, eye: Array, focal: float, category: str, road: Array
) -> NDArray[np.float32]:
    """Numbers (GEOMETRY,), each of order one."""
    distance = float(np.linalg.norm(eye))
    azimuth, elevation = np.arctan2(abs(eye[1]), eye[0]), np.arcsin(eye[2] / distance)
    named = [float(category == name) for name in CATEGORIES]
    return np.array(
        [
            *(np.log(size) - np.log([4.5, 1.8, 1.5])) * 3,
            np.cos(azimuth),
            np.sin(azimuth),
            np.cos(2 * azimuth),
            np.sin(2 * azimuth),
            5 * elevation,
            np.log(distance / 12),
            np.log(focal / distance / 40),
            *_facing(size, eye)[:2],
            np.log(road_level(road)),
            float(np.isfinite(road).all()),
            *(10 * np.log(road_tint(road)[::2])),
            *named,
        ],
        np.float32,
    )
