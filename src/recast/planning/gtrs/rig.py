"""nuPlan's three front cameras, to be rendered where the released models should feel at home."""

from __future__ import annotations

from recast.geometry import PinholeCamera
from recast.planning.types import CameraMount
from recast.planning.views import camera_pose

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
