"""Images of a scene by ray tracing: what a camera on a car would take."""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera, se3
from recast.synthetic.rendering.camera_frame import CameraFrame
from recast.synthetic.rendering.ray_scene import Poses, RayScene
from recast.synthetic.rendering.sky_light import sky_light
from recast.synthetic.rendering.trace_image import trace_image
from recast.synthetic.world import Quality, Sky

Array = NDArray[np.float64]


def render_camera(
    scene: RayScene,
    sky: Sky,
    camera: PinholeCamera,
    world_from_camera: ArrayLike,
    poses: Poses,
    *,
    rng: np.random.Generator,
    exposure: float = 1.0,
    quality: Quality = "standard",
) -> CameraFrame:
    """Take one image.

    Args:
        scene: may have an empty street.
        sky: daylight.
        camera: may have distortion.
        world_from_camera: (4, 4) rigid.
        poses: `world_from_actor` (4, 4) by model name; models not named are absent.
        rng: of the samples of light.
        exposure: factor on the light, 1 is right for the day.
        quality: "mitsuba" path traces the light of the sky, with four bounces instead of two, at
            several times the cost; needs the extra `mitsuba` and LLVM.

    Raises:
        InputError: mitsuba is asked for and does not run here.
        ValueError: a size or a pose that cannot be, an exposure that is not positive, or a name
            that is not among the models.
    """
    camera.validate()
    pose = np.asarray(world_from_camera, np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"world_from_camera: expected a finite (4, 4), got {pose.shape}")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure: must be positive, got {exposure}")
    if quality not in get_args(Quality):
        raise ValueError(f"quality: {quality!r} is none of {get_args(Quality)}")
    posed, light = scene.posed(poses), sky_light(sky)
    width, height = camera.width, camera.height
    if len(scene.static):
        return trace_image(posed, light, camera, pose, rng, exposure, quality)
    # Nothing but vehicles: trace only the part of the image that they can cover.
    left, top, right, bottom = _covered(scene, camera, pose, poses)
    part = camera.cropped(left, top, right - left, bottom - top)
    return trace_image(posed, light, part, pose, rng, exposure, quality).within(
        width, height, left, top
    )


def _covered(
    scene: RayScene, camera: PinholeCamera, world_from_camera: Array, poses: Poses
) -> tuple[int, int, int, int]:
    """Pixels left, top, right, bottom, at least one, around the boxes of all posed models."""
    everything = 0, 0, camera.width, camera.height
    camera_from_world = se3.inverse(world_from_camera)
    corners = []
    for bounds, name in zip(scene.bounds[1:], scene.names, strict=True):
        if name in poses:
            box = np.array(
                [[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]]
            )
            corners.append(se3.apply(camera_from_world @ poses[name], box))
    if not corners:
        return 0, 0, 1, 1
    points = np.concatenate(corners)
    # Behind the camera, or through a lens that bends lines, corners do not bound what is inside.
    if points[:, 2].min() < 0.05 or not camera.is_rectified:
        return everything
    pixels, _ = camera.project(points)
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 2, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
