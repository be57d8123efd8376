"""Which images of the drives count for every arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.evaluation.oracle_scores import Rectangle
from recast.evaluation.scene_level.frames import FrameRule, RolloutFrame, visible_share
from recast.geometry import se3
from recast.planning import CameraMount
from recast.scene import SceneRasterizer, StreetScene
from recast.simulation import Rollout
from recast.synthetic import Oracle, World

Array = NDArray[np.float64]
Depth = NDArray[np.float32]
DepthOf = Callable[[CameraMount, Array, Rectangle], Depth]
"""Depth (H, W) in metres along z of a street without the target: from a mount, at
`world_from_camera` (4, 4), for points inside of a rectangle at least; inf for the sky."""

_SOLID = 0.5
"""Opacity from which a street hides what lies behind it."""


def visible_frames(
    rollouts: Sequence[Rollout],
    mounts: Mapping[str, CameraMount],
    rule: FrameRule,
    depths: Sequence[DepthOf],
) -> Iterator[RolloutFrame]:
    """Images that count, by rollout, step and camera: no street hides the vehicle in them.

    Args:
        mounts: cameras as they are rendered.
        depths: depth functions of every street that an arm uses.
    """
    for rollout in rollouts:
        size = rollout.actor_size
        for step in range(0, rollout.steps_run, rule.every):
            for name, mount in mounts.items():
                world_from_camera = rollout.world_from_rig[step] @ mount.rig_from_camera
                seen_from = se3.inverse(world_from_camera) @ rollout.world_from_actor[step]
                rectangle = rule.rectangle(size, seen_from, mount.camera)
                if rectangle is None:
                    continue
                shares = (
                    visible_share(
                        depth(mount, world_from_camera, rectangle), size, seen_from, mount.camera
                    )
                    for depth in depths
                )
                if all(share >= rule.least_visible for share in shares):
                    yield RolloutFrame(rollout.motion, rollout.setting, step, name, rectangle)


def street_depth(street: StreetScene, track_id: str) -> DepthOf:
    """Depth of a reconstructed street without a track."""
    others = {key: one for key, one in street.actors.items() if key != track_id}
    rasterizer = SceneRasterizer(replace(street, actors=others))

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        del rectangle
        image = rasterizer.render(mount.camera, se3.inverse(world_from_camera), {})
        solid = image.alpha > _SOLID
        return np.where(solid, image.depth / np.where(solid, image.alpha, 1), np.float32(np.inf))

    return depth


def true_depth(world: World, track_id: str) -> DepthOf:
    """Depth of a synthetic world without a track."""
    oracle = Oracle(world)
    underground = np.eye(4)
    underground[2, 3] = -1000.0
    # A parked vehicle is part of the world, so it is put where no ray meets it.
    poses = {track_id: underground} if world.vehicles[track_id].parked else {}

    def depth(mount: CameraMount, world_from_camera: Array, rectangle: Rectangle) -> Depth:
        left, top, right, bottom = rectangle
        window = mount.camera.cropped(left, top, right - left, bottom - top)
        frame = oracle.render(window, world_from_camera, poses)
        return frame.within(mount.camera.width, mount.camera.height, left, top).depth

    return depth
