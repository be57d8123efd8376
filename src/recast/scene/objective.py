"""What a step minimises: a rendered view against the recorded one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from recast.geometry import boxes
from recast.scene.config import SceneConfig
from recast.scene.drawn import Drawn
from recast.scene.levels import Level
from recast.scene.losses import (
    depth_loss,
    photometric_loss,
    sky_entropy,
    sky_loss,
    solid_loss,
)
from recast.scene.regularisers import actor_opacity
from recast.scene.street_scene import Array
from recast.scene.trainable import rows
from recast.splats import Gaussians, Rasterization, rasterize


def view_loss(
    config: SceneConfig, image: Tensor, result: Rasterization, level: Level, threads: int
) -> Tensor:
    """The weighted sum of photometric, depth, sky and opacity loss.

    Args:
        image: (H, W, 3) composited, unusable pixels black.
        result: what the image was made of.
    """
    loss = photometric_loss(image, level.target, config.ssim_weight, threads)
    if config.depth_weight > 0:
        depth = depth_loss(
            result.depth,
            result.alpha,
            level.depth_pixels,
            level.depths,
            config.depth_keep,
            config.depth_error,
        )
        loss = loss + config.depth_weight * depth
    if config.sky_weight > 0:
        if config.sky_loss == "entropy":
            sky = sky_entropy(result.alpha, level.sky, level.ground)
        else:
            sky = sky_loss(result.alpha, level.sky)
        loss = loss + config.sky_weight * sky
    if config.solid_weight > 0:
        loss = loss + config.solid_weight * solid_loss(result.alpha, level.ground)
    return loss


def actors_alone(
    drawn: Drawn, pose: Tensor, level: Level, placed: Sequence[tuple[Array, Tensor]]
) -> Tensor:
    """`regularisers.actor_opacity` of a view's actors, rendered a second time without the rest.

    Args:
        pose: (4, 4) camera_from_world.
        placed: size (3,) and `world_from_actor` (4, 4) of each actor that is drawn.
    """
    if not drawn.spans:
        return pose.new_zeros(())
    first, camera = drawn.spans[0].first, level.camera
    own = Gaussians(**{name: value[first:] for name, value in rows(drawn.gaussians).items()})
    alpha = rasterize(own, pose, level.K, camera.width, camera.height).alpha
    camera_from_world = pose.detach().double().cpu().numpy()
    inside = np.zeros((camera.height, camera.width), bool)
    for size, world_from_actor in placed:
        box = camera_from_world @ world_from_actor.detach().double().cpu().numpy()
        rectangle = boxes.project(size, box, camera)
        if rectangle is not None:
            left, top = np.floor(np.maximum(rectangle[:2], 0)).astype(int)
            right, bottom = np.ceil(np.maximum(rectangle[2:], 0)).astype(int)
            inside[top:bottom, left:right] = True
    return actor_opacity(alpha, torch.from_numpy(inside).to(alpha.device))
