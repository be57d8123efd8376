"""DAC: whether the ego stays on the drivable area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.evaluation.metric import Metric, invalid
from recast.geometry import boxes

Array = NDArray[np.float64]

TOLERANCE = 0.3
"""Metres that a corner may leave the drivable area."""

_CORNERS = ("front left", "rear left", "rear right", "front right")


@dataclass(frozen=True)
class DrivableArea:
    """DAC of a rollout.

    Attributes:
        dac: 1 while every corner stays within 0.3 m of the drivable area, else 0.
        distance: (S+1, 4) metres from each corner to the area, 0 inside; corners front left, rear
            left, rear right, front right. None without a map.
        first_step: first state with a corner too far out, or None.
    """

    dac: Metric
    distance: Array | None
    first_step: int | None


def drivable_area_compliance(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    region: shapely.Geometry | None,
    dt: float,
    tolerance: float = TOLERANCE,
) -> DrivableArea:
    """DAC: 1 iff all four corners lie within `tolerance` metres of the region in every state.

    Args:
        ego_boxes: (S+1, 3) x, y, heading of the ego's box centre.
        ego_size: (2,) length and width in metres.
        region: from `drivable_region`; None makes the metric invalid.
        dt: seconds between states.
    """
    if region is None:
        return DrivableArea(invalid("no drivable area in the map"), None, None)
    length, width = np.asarray(ego_size, np.float64)[:2]
    corners = boxes.bev_corners(ego_boxes, length, width)
    shapely.prepare(region)
    distance = np.asarray(shapely.distance(region, shapely.points(corners)), np.float64)
    outside = np.flatnonzero(np.any(distance > tolerance, axis=1))
    if len(outside) == 0:
        return DrivableArea(Metric(1.0), distance, None)
    first = int(outside[0])
    corner = int(np.argmax(distance[first]))
    reason = (
        f"{_CORNERS[corner]} corner {distance[first, corner]:.2f} m outside "
        f"at step {first} ({first * dt:.1f} s); {distance.max():.2f} m at the worst"
    )
    return DrivableArea(Metric(0.0, reason), distance, first)
