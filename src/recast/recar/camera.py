"""Where the cameras of a vehicle set stand.

The actor frame is that of all boxes: origin at the box centre, x forward, y left, z up. A camera at
azimuth a and elevation e stands at `distance * (cos e cos a, cos e sin a, sin e)` and looks at the
origin, level. So at azimuth 0 it looks at the front, and the vehicle's left side is to the right in
the image; at azimuth 90 it looks at the left side, and the front points to the left in the image.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera, boxes, se3
from recast.recar.record import IdentityRecord, SetRecord

Array = NDArray[np.float64]

ELEVATION_DEG = 15.0
FOV_DEG = 40.0
MARGIN = 0.04
"""Share of the image that stays free at each edge, at the azimuth where the vehicle is widest."""


def view_camera(
    vehicle_set: SetRecord, identity: IdentityRecord, index: int
) -> tuple[PinholeCamera, Array]:
    """The camera of a view, and `actor_from_camera` (4, 4).

    Raises:
        IndexError: no such view.
        ValueError: elevation, angle of view or distance was not measured.
    """
    if not 0 <= index < vehicle_set.views:
        raise IndexError(f"view {index}: {identity.id} has views 0 to {vehicle_set.views - 1}")
    elevation, fov, distance = vehicle_set.elevation_deg, vehicle_set.fov_deg, identity.distance_m
    if elevation is None or fov is None or distance is None:
        raise ValueError(
            f"{identity.id}: no camera without elevation ({elevation}), fov ({fov}) and distance "
            f"({distance})"
        )
    camera = pinhole(vehicle_set.width, vehicle_set.height, fov)
    return camera, camera_pose(vehicle_set.azimuths_deg[index], elevation, distance)


def pinhole(width: int, height: int, fov_deg: float) -> PinholeCamera:
    """A camera with `fov_deg` across its width, square pixels, principal point in the middle."""
    focal = width / 2 / float(np.tan(np.radians(fov_deg) / 2))
    return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


def camera_pose(azimuth_deg: float, elevation_deg: float, distance: float) -> Array:
    """`actor_from_camera` (4, 4) of the level OpenCV camera there that looks at the box centre."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    forward = -np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return se3.from_rotation_translation(rotation, -distance * forward)


def fitting_distance(
    size: ArrayLike,
    camera: PinholeCamera,
    elevation_deg: float = ELEVATION_DEG,
    margin: float = MARGIN,
    azimuths_deg: Iterable[float] = range(91),
) -> float:
    """Metres at which a box of `size` (3,) just fits the image from all azimuths given.

    Args:
        size: length, width, height in metres.
        camera: rectified, principal point in the middle.
        elevation_deg: of the camera.
        margin: share of width and height that stays free at each edge.
        azimuths_deg: a quarter is as good as all of them, by symmetry of the box.
    """
    corners = boxes.corners(size)
    least = 0.0
    for azimuth in azimuths_deg:
        # About the centre, in camera axes: a corner at depth d + z is inside while
        # f |x| <= (1/2 - margin) width (d + z), and alike for y.
        about = corners @ camera_pose(azimuth, elevation_deg, 0.0)[:3, :3]
        across = np.abs(about[:, 0]) * camera.fx / ((0.5 - margin) * camera.width)
        upright = np.abs(about[:, 1]) * camera.fy / ((0.5 - margin) * camera.height)
        least = max(least, float(np.max(np.maximum(across, upright) - about[:, 2])))
    return least
