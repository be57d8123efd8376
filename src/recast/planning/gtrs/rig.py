"""nuPlan's three front cameras, to be rendered where the released models should feel at home."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera, se3
from recast.planning.types import CameraMount

Array = NDArray[np.float64]

NUPLAN_CAMERAS = ("nuplan_l0", "nuplan_f0", "nuplan_r0")
"""Left, front and right."""

NUPLAN_CAMERA = PinholeCamera(
    width=1920,
    height=1080,
    fx=1545.0,
    fy=1545.0,
    cx=960.0,
    cy=560.0,
    distortion=(-0.356123, 0.172545, -0.002130, 0.000464, -0.052310),
)
"""Intrinsics shared by all three; the images are as distorted as this says."""

_MOUNTS = (
    ((1.646, 0.143, 1.521), 55.2, -0.5),
    ((1.670, -0.026, 1.523), 0.2, -1.5),
    ((1.626, -0.162, 1.526), -55.5, 0.4),
)


def nuplan_rig(scale: float = 1.0) -> dict[str, CameraMount]:
    """The virtual rig by camera name, in the rear-axle frame.

    NAVSIM feeds the planner the raw images, with their distortion. A renderer of pinhole images
    renders with `Lens(camera).source` and bends the result: see
    `recast.simulation.lens_renderer.through_lenses`.

    Args:
        scale: of width and height, rounded to whole pixels.

    Source: nuPlan's published calibration, rounded: position in metres, yaw to the left, pitch
    upwards (the optical axis of the front camera points 1.5 degrees below the horizon), no roll.
    """
    size = round(NUPLAN_CAMERA.width * scale), round(NUPLAN_CAMERA.height * scale)
    camera = NUPLAN_CAMERA.resized(*size)
    return {
        name: CameraMount(camera, camera_pose(position, yaw, pitch))
        for name, (position, yaw, pitch) in zip(NUPLAN_CAMERAS, _MOUNTS, strict=True)
    }


def camera_pose(position: tuple[float, float, float], yaw: float, pitch: float) -> Array:
    """`rig_from_camera` (4, 4) of a camera without roll.

    Args:
        position: metres in the rig frame (x forward, y left, z up).
        yaw, pitch: degrees of the optical axis: to the left of x, and upwards.
    """
    turn, rise = np.deg2rad(yaw), np.deg2rad(pitch)
    forward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return se3.from_rotation_translation(rotation, np.array(position))
