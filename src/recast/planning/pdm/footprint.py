"""The ego's box around rear-axle poses."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import VehicleParameters
from recast.geometry import boxes, se2

Array = NDArray[np.float64]


def box_centres(poses: ArrayLike, vehicle: VehicleParameters) -> Array:
    """Centres (..., 3), headings included, of the boxes of rear-axle poses (..., 3)."""
    return se2.compose(poses, np.array([vehicle.centre_offset, 0.0, 0.0]))


def box_corners(poses: ArrayLike, vehicle: VehicleParameters) -> Array:
    """Corners (..., 4, 2) front left, rear left, rear right, front right of rear-axle poses."""
    return boxes.bev_corners(box_centres(poses, vehicle), vehicle.length, vehicle.width)


def outline(pose: ArrayLike, vehicle: VehicleParameters) -> shapely.Polygon:
    """The box of one rear-axle pose (3,) as a polygon."""
    return shapely.Polygon(box_corners(pose, vehicle))
