from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.logs import DrivingLog
from recast.reconstruction import TrainResult
from recast.reconstruction.views import TrainingView, read_view
from recast.scene import SceneRasterizer, render_scene
from recast.scene.sky import OPAQUE
from recast.splats import MIP, rasterize


@pytest.fixture(scope="module")
def view(tiny_log: DrivingLog) -> TrainingView:
    return read_view(tiny_log, tiny_log.cameras["image_02"], 3, 1.0)


def test_fast_path_equals_the_plain_one(trained: TrainResult, view: TrainingView) -> None:
    scene = trained.scene
    poses = scene.actor_poses(view.timestamp_us)
    assert poses
    fast = SceneRasterizer(scene)
    fast.render(view.camera, view.camera_from_world, {})  # leaves nothing behind
    image = fast.render(view.camera, view.camera_from_world, poses)
    K = torch.from_numpy(view.camera.matrix).float()
    pose = torch.from_numpy(view.camera_from_world).float()
    assert scene.low_pass == MIP == scene.actors["0"].low_pass
    filters = {"eps2d": MIP.variance, "antialiased": MIP.antialiased}
    plain = rasterize(scene.at(poses), pose, K, view.camera.width, view.camera.height, **filters)
    rays = view.camera.rays(view.camera.pixel_grid()) @ view.world_from_camera[:3, :3].T
    sky = scene.sky(torch.from_numpy(rays).float().view(-1, 3))
    through = torch.where(plain.alpha < OPAQUE, 1 - plain.alpha, 0.0)[..., None]
    expected = (plain.rgb + through * sky.view_as(plain.rgb)).clamp(0, 1).numpy()
    assert np.abs(image.rgb - expected).max() < 1 / 255  # a hundredth of a sky cell
    assert np.abs(image.alpha - plain.alpha.numpy()).max() < 1e-4
    assert np.abs(image.depth - plain.depth.numpy()).max() < 1e-2
    assert image.rgb.dtype == np.float32


def test_actors_without_a_pose_are_absent(trained: TrainResult, view: TrainingView) -> None:
    scene = trained.scene
    poses = scene.actor_poses(view.timestamp_us)
    without = render_scene(scene, view.camera, view.camera_from_world, {})
    with_actor = render_scene(scene, view.camera, view.camera_from_world, poses)
    assert np.abs(without.rgb - with_actor.rgb).max() > 0.1
    with pytest.raises(KeyError):
        render_scene(scene, view.camera, view.camera_from_world, {"nobody": np.eye(4)})


def test_a_moved_actor_moves_in_the_image(trained: TrainResult, view: TrainingView) -> None:
    scene = trained.scene
    (track_id, pose), *_ = scene.actor_poses(view.timestamp_us).items()
    empty = render_scene(scene, view.camera, view.camera_from_world, {}).rgb

    def centre(shift: float) -> float:
        moved = pose.copy()
        moved[:3, 3] += shift * pose[:3, 1]  # to its left
        image = render_scene(scene, view.camera, view.camera_from_world, {track_id: moved}).rgb
        changed = np.abs(image - empty).sum(-1)
        return float((changed.sum(0) * np.arange(view.camera.width)).sum() / changed.sum())

    assert centre(0.5) < centre(-0.5) - 2
