"""An observation from a single segmented picture with a known camera, without a drive around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.actors.observation import Observation, ViewScore
from recast.actors.segment import SegmentationTarget, mask_quality
from recast.geometry import PinholeCamera, se3

Array = NDArray[np.float64]

_MARGIN = 0.18  # share of the mask's longer side left around it, as `observe` leaves around the box


def observation_of_view(
    rgba: NDArray[np.uint8],
    camera: PinholeCamera,
    camera_from_object: Array,
    size: ArrayLike,
    *,
    name: str,
    category: str = "car",
) -> Observation:
    """The picture, cut to a nearly square window around its mask, as an observation without LiDAR.

    Args:
        rgba: (H, W, 4) uint8, alpha on the vehicle; colours without alpha are kept, generators
            read the light from them.
        camera: of the picture, without distortion.
        camera_from_object: (4, 4), object frame: box centre, x forward, y left, z up.
        size: (3,) length, width, height of the vehicle's box, metres.
        name: of the picture, for the record.
        category: see `recast.logs.Track`.

    Raises:
        ValueError: the mask is empty.
    """
    left, top, width, height = _window(rgba[..., 3] > 127)
    crop = np.ascontiguousarray(rgba[top : top + height, left : left + width])
    cropped = camera.cropped(left, top, width, height)
    none = np.zeros((0, 3))
    target = SegmentationTarget(
        crop[..., :3], cropped, camera_from_object, np.asarray(size, np.float64), none, none
    )
    pixels = float(np.sqrt((crop[..., 3] > 127).sum()))
    eye = se3.inverse(camera_from_object)[:3, 3]
    view = ViewScore(
        name, 0, 0, pixels, in_image=1.0, unoccluded=1.0, unblocked=1.0,
        azimuth=float(np.arctan2(eye[1], eye[0])),
    )  # fmt: skip
    return Observation(
        track_id=name,
        category=category,
        size=target.size,
        rgba=crop,
        camera=cropped,
        camera_from_object=np.asarray(camera_from_object, np.float64),
        points=none.astype(np.float32),
        view=view,
        candidates=(view,),
        mask_quality=mask_quality(target, crop[..., 3]),
    )


def _window(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, top, width, height of a square around a mask (H, W), clipped to the picture."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        raise ValueError("observation_of_view: the mask is empty")
    low = np.array([columns[0], rows[0]])
    high = np.array([columns[-1], rows[-1]]) + 1
    half = float(np.max(high - low)) * (0.5 + _MARGIN)
    centre = (low + high) / 2
    first = np.maximum(np.floor(centre - half), 0).astype(int)
    last = np.minimum(np.ceil(centre + half), mask.shape[::-1]).astype(int)
    return int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1])
