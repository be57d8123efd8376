from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from recast.cameras import CameraMount
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reconstruction import TrainResult
from recast.reconstruction.evaluate import draw_view
from recast.reconstruction.views import TrainingView, read_view
from recast.scene import SceneRasterizer, render_scene
from recast.scene.sky import OPAQUE
from recast.scene.street_scene import twist_matrix
from recast.simulation.scene_renderer import SceneRenderer
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


def test_an_image_is_exposed_as_its_camera_was(trained: TrainResult, view: TrainingView) -> None:
    start = int(view.timestamp_us)
    affines = np.zeros((2, 3, 4))
    affines[:, :, :3] = np.array([0.5, 0.7])[:, None, None] * np.eye(3)
    affines[1, :, 3] = 0.1
    times = np.array([start, start + 100_000])
    plain = replace(trained.scene, exposures={})
    scene = replace(plain, exposures={view.camera_name: (times, affines)})
    scene.validate()
    assert scene.exposure("other", start) is None
    mount = CameraMount(view.camera, np.eye(4))
    mounts = {view.camera_name: mount, "other": mount}
    world_from_rig = np.linalg.inv(view.camera_from_world)
    for share in (-1.0, 0.0, 0.5, 1.0, 2.0):
        within = min(max(share, 0.0), 1.0)
        state: Any = SimpleNamespace(
            log_mounts={},
            timestamp_us=start + int(share * 100_000),
            actors={},
            poses={},
            world_from_rig=world_from_rig,
        )
        seen = SceneRenderer(scene, mounts).render(state, list(mounts))
        expected = (0.5 + 0.2 * within) * seen["other"] / 255 + 0.1 * within
        assert np.abs(seen[view.camera_name] / 255 - expected).max() < 1.5 / 255
    drawn, dark = (draw_view(SceneRasterizer(one), one, view).rgb for one in (plain, scene))
    assert np.abs(dark - 0.5 * drawn).max() < 1e-3
    with pytest.raises(ValueError, match=r"exposures.*transforms"):
        replace(scene, exposures={"front": (times, affines[:1])}).validate()


def test_cameras_sit_where_training_learned_that_they_do(
    trained: TrainResult, tiny_log: DrivingLog, view: TrainingView
) -> None:
    scene, name = trained.scene, view.camera_name
    rig_from_camera = tiny_log.cameras[name].rig_from_camera
    _, twists = scene.camera_corrections[name]
    mean = twist_matrix(torch.from_numpy(twists.mean(axis=0))).numpy()
    assert np.abs(twists).max() > 0
    assert np.allclose(scene.mounted(rig_from_camera, name) @ mean, rig_from_camera, atol=1e-9)
    assert scene.mounted(rig_from_camera, "other") is rig_from_camera
    turn = se3.from_rotation_translation(se3.rotation_z(0.02), np.array([0.0, 0.3, 0.1]))
    moved = replace(scene, mounts={name: turn}, exposures={})
    moved.validate()
    time = int(view.timestamp_us)
    state: Any = SimpleNamespace(
        log_mounts={},
        timestamp_us=time,
        actors={},
        poses={},
        world_from_rig=tiny_log.world_from_rig.at(time),
    )
    mounts = {
        name: CameraMount(view.camera, rig_from_camera),
        "virtual": CameraMount(view.camera, rig_from_camera, source=name),
        "by hand": CameraMount(view.camera, turn @ rig_from_camera),
        "as logged": CameraMount(view.camera, rig_from_camera),
    }
    seen = SceneRenderer(moved, mounts).render(state, list(mounts))
    assert np.array_equal(seen[name], seen["by hand"])
    assert np.array_equal(seen["virtual"], seen["by hand"])
    assert np.abs(seen[name].astype(int) - seen["as logged"]).max() > 20
    with pytest.raises(ValueError, match=r"mounts\['image_02'\]"):
        replace(scene, mounts={name: turn[:3]}).validate()
