"""The road that a vehicle covered in every image that shows it.

Nothing teaches the Gaussians there: what shines through a vehicle that is not quite opaque, and
what the first points happened to be, is left over, and is seen as a smear as soon as a scenario
moves the vehicle away. It is coloured like the road before and behind it instead: markings go on
along the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from recast.arrays import Array
from recast.logs import DrivingLog, Trajectory
from recast.reconstruction.views import TrainingView
from recast.scene.street_scene import SceneRasterizer, StreetScene
from recast.splats import rasterize
from recast.splats.gaussians import C0

# Chosen by eye and by PSNR against the truth on urban-straight 51 and suburban-curve 52.
_COVERED = 0.3
"""Pixels, summed over all images, that a Gaussian must have contributed behind vehicles."""
_FREE, _FREE_SHARE = 0.5, 0.1
"""Pixels, and share of those behind vehicles, below which what it showed beside them is too little
to have taught its colour."""
_TAUGHT = 2.0
"""Pixels beside vehicles from which on a Gaussian is road that others are coloured by."""
_FLAT, _HIGH = 0.12, 2.5
"""Metres off the road's height within which a Gaussian is of the road, and up to which one that
stands on it is left over from a vehicle."""
_BESIDE = 15.0
"""Metres from the drive within which the road is looked for."""
_ALONG = 0.05
"""A metre along the drive counts as much as this across: markings run along."""
_NEAREST = 12


def without_leftovers(
    scene: StreetScene, log: DrivingLog, views: Sequence[TrainingView]
) -> StreetScene:
    """The scene with the road plain where a vehicle covered it in all `views`.

    Gaussians that are coloured anew are marked as unseen; those above the road vanish.
    """
    moving = [key for key in scene.actors if key not in scene.standing]
    if not moving or not len(log.world_from_rig.poses):
        return scene
    behind, beside = shown_behind(scene, views, moving)
    covered = (behind > _COVERED) & (beside < np.maximum(_FREE, _FREE_SHARE * behind))
    background = scene.background
    along, across, height = _by_the_drive(log.world_from_rig, background.means.numpy())
    near = np.abs(across) < _BESIDE
    road = near & (np.abs(height) < _FLAT)
    wrong, left = covered & road, covered & near & (height >= _FLAT) & (height < _HIGH)
    known = road & ~covered & (beside > _TAUGHT)
    if not wrong.any() or known.sum() < _NEAREST:
        return scene
    places = np.stack([_ALONG * along, across], axis=-1)
    distance, index = cKDTree(places[known]).query(places[wrong], k=_NEAREST)
    weight = 1 / (distance + 0.02) ** 2
    constant = background.sh[:, 0].numpy()
    mean = (constant[known][index] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
    sh, opacities = background.sh.clone(), background.logit_opacities.clone()
    chosen = torch.from_numpy(wrong)
    sh[chosen] = 0.0
    sh[chosen, 0] = torch.from_numpy(mean).to(sh)
    opacities[torch.from_numpy(left)] = _GONE
    unseen = None if scene.unseen is None else scene.unseen | chosen
    return replace(
        scene, background=replace(background, sh=sh, logit_opacities=opacities), unseen=unseen
    )


_GONE = -12.0  # logit of an opacity that nothing draws


def shown_behind(
    scene: StreetScene, views: Sequence[TrainingView], tracks: Sequence[str]
) -> tuple[Array, Array]:
    """Pixels (N,) that each Gaussian of the background contributes to all images, as far as the
    vehicles of `tracks` cover them, and as far as they do not."""
    background, rasterizer = scene.background.detach(), SceneRasterizer(scene, "cpu")
    behind, beside = (np.zeros(len(background.means)) for _ in range(2))
    for view in views:
        time, camera = view.timestamp_us, view.camera
        pose = scene.corrected_camera(view.camera_from_world, view.camera_name, time)
        poses = {k: p for k, p in scene.actor_poses(time).items() if k in tracks}
        alpha = torch.zeros((camera.height, camera.width))
        if poses:
            alpha = rasterizer.layer(camera, pose, poses, shapes_us=time, street=False).alpha
        # The gradient of a sum of pixels by a colour is what the Gaussian contributes to them.
        colours = torch.zeros((len(background.means), 1, 3), requires_grad=True)
        drawn = rasterize(
            replace(background, sh=colours),
            torch.from_numpy(pose),
            torch.from_numpy(camera.matrix).float(),
            camera.width,
            camera.height,
            eps2d=scene.low_pass.variance,
            antialiased=scene.low_pass.antialiased,
        )
        ((drawn.rgb[..., 0] * alpha).sum() + (drawn.rgb[..., 1] * (1 - alpha)).sum()).backward()
        assert colours.grad is not None
        behind += colours.grad[:, 0, 0].numpy() / C0
        beside += colours.grad[:, 0, 1].numpy() / C0
    return behind, beside


def _by_the_drive(drive: Trajectory, points: Array) -> tuple[Array, Array, Array]:
    """Metres along the drive, to the left of it, and above the ground there, of points (N, 3)."""
    places, forward = drive.poses[:, :3, 3], drive.poses[:, :2, 0]
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=-1)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    _, index = cKDTree(places[:, :2]).query(points[:, :2])
    apart = points - places[index]
    ahead = forward[index]
    along = driven[index] + (apart[:, :2] * ahead).sum(axis=-1)
    across = ahead[:, 0] * apart[:, 1] - ahead[:, 1] * apart[:, 0]
    return along, across, apart[:, 2]
