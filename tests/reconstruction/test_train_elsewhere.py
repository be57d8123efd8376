"""Training and drawing on another device, played through without one."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from recast.cameras import CameraMount
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.reconstruction import TrainingStatus, TrainResult, train_scene
from recast.reconstruction.losses import photometric_loss
from recast.reconstruction.train import WORK_FOLDER
from recast.scene.street_scene import SceneRasterizer
from recast.simulation.scene_renderer import SceneRenderer
from recast.splats import Rasterization, rasterize
from recast.splats.cuda import pick_device
from support.elsewhere import ELSEWHERE, elsewhere
from support.tiny_street import TINY, KilledError

SHORT = TINY.model_copy(
    update={
        "iterations": 10,
        "sweep_points": 0,
        "densify_every": 4,
        "evaluate_every": 10,
        "checkpoint_every": 5,
    }
)


class Meta:
    """`RasterMeta` of a rendering on the CPU, taken elsewhere; the gradient once it is there."""

    def __init__(self, meta: Any) -> None:
        self._meta = meta

    def __getattr__(self, name: str) -> torch.Tensor | None:
        value = getattr(self._meta, name)
        return None if value is None else value.to(ELSEWHERE)


def rasterize_elsewhere(
    gaussians: Any, pose: torch.Tensor, *arguments: Any, **options: Any
) -> Rasterization:
    """The CPU kernel in gsplat's place, for Gaussians elsewhere."""
    if gaussians.means.device != ELSEWHERE:
        return rasterize(gaussians, pose, *arguments, **options)
    drawn = rasterize(gaussians.to("cpu"), pose.cpu(), *arguments, **options)
    images = (getattr(drawn, name).to(ELSEWHERE) for name in ("rgb", "depth", "alpha"))
    return Rasterization(*images, Meta(drawn.meta))


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`ELSEWHERE` is the device that is picked."""
    for name in ("reconstruction.step", "reconstruction.losses", "splats.rasterize"):
        monkeypatch.setattr(sys.modules[f"recast.{name}"], "rasterize", rasterize_elsewhere)
    for name in ("reconstruction.train", "scene.street_scene"):
        monkeypatch.setattr(
            sys.modules[f"recast.{name}"],
            "pick_device",
            lambda name: ELSEWHERE if name == "auto" else pick_device(name),
        )
    with elsewhere():
        yield


def test_the_photometric_loss_elsewhere_is_the_fused_one() -> None:
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(2, 20, 30, 3, generator=generator)
    here = image.clone().requires_grad_()
    fused = photometric_loss(here, target)
    fused.backward()
    with elsewhere() as device:
        there = image.to(device).requires_grad_()
        loss = photometric_loss(there, target.to(device))
        loss.backward()
        assert float(loss.detach()) == pytest.approx(float(fused.detach()), rel=1e-5)
        difference = there.grad.cpu() - here.grad
    assert float(difference.norm()) < 1e-4 * float(here.grad.norm())


@pytest.mark.usefixtures("there")
def test_training_elsewhere_learns_the_same(tiny_log: DrivingLog, tmp_path: Path) -> None:
    def kill(status: TrainingStatus) -> None:
        if status.phase == "train":
            raise KilledError

    with pytest.raises(KilledError):
        train_scene(tiny_log, tmp_path / "there", SHORT, kill)
    copytree(tmp_path / "there", tmp_path / "here")
    (tmp_path / "here" / WORK_FOLDER / "checkpoint.safetensors").unlink()
    # Taken up from the checkpoint after step 5, past a change of the population.
    there = train_scene(tiny_log, tmp_path / "there", SHORT)
    here = train_scene(tiny_log, tmp_path / "here", SHORT, device="cpu")
    assert there.scene.background.means.device.type == "cpu"
    got, wanted = there.history[-1], here.history[-1]
    assert got["gaussians"] == pytest.approx(wanted["gaussians"], rel=0.02)
    assert got["loss"] == pytest.approx(wanted["loss"], rel=0.02)
    assert got["held_out_psnr"] == pytest.approx(wanted["held_out_psnr"], abs=0.3)
    for track_id, actor in here.scene.actors.items():
        poses = there.scene.actors[track_id].trajectory.poses
        assert np.allclose(poses, actor.trajectory.poses, atol=5e-3)


@pytest.mark.usefixtures("there")
def test_every_method_works_elsewhere(tiny_log: DrivingLog, tmp_path: Path) -> None:
    everything = SHORT.model_copy(
        update={
            "sky": "cubemap",
            "sky_face_px": 8,
            "fourier_terms": 3,
            "flip_probability": 0.5,
            "exposure_lr": 1e-3,
            "exposure_weight": 1e-3,
            "depth_error": "metric",
            "sky_loss": "entropy",
            "sharp_shape_weight": 1.0,
            "track_smoothness_weight": 0.01,
            "actor_opacity_weight": 0.1,
            "densify_until": 0.6,
            "opacity_reset_every": 0.3,
            "prune_above_m": 1.0,
        }
    )
    result = train_scene(tiny_log, tmp_path / "there", everything)
    assert result.history[-1]["held_out_psnr"] > 5  # just after a reset of opacities


@pytest.mark.usefixtures("there")
def test_a_scene_drawn_elsewhere_looks_the_same(trained: TrainResult, tiny_log: DrivingLog) -> None:
    scene = trained.scene
    name, stream = next(iter(tiny_log.cameras.items()))
    time = int(stream.timestamps_us[0])
    rig = tiny_log.world_from_rig.at(time)
    pose = se3.inverse(rig @ scene.mounted(stream.rig_from_camera, name))
    camera, poses = stream.camera.rectified(), scene.actor_poses(time)
    assert poses
    rasterizer = SceneRasterizer(scene)
    assert rasterizer.draw(camera, pose, poses).rgb.device == ELSEWHERE
    exposure = scene.exposure(name, time)
    got = rasterizer.render(camera, pose, poses, exposure=exposure)
    expected = SceneRasterizer(scene, "cpu").render(camera, pose, poses, exposure=exposure)
    # Frozen scenes on the CPU keep their colours in half precision: within a grey level.
    for part, size in (("rgb", 1.0), ("depth", float(expected.depth.max())), ("alpha", 1.0)):
        difference = np.abs(getattr(got, part) - getattr(expected, part))
        assert difference.max() < size / 255, part
        assert difference.mean() < size * 1e-4, part

    mounts = {name: CameraMount(camera, stream.rig_from_camera)}
    track_id = next(iter(poses))
    state: Any = SimpleNamespace(
        log_mounts={}, timestamp_us=time, actors={track_id: None}, poses=poses, world_from_rig=rig
    )
    image = SceneRenderer(scene, mounts).render(state, [name])[name]
    assert image.dtype == np.uint8
    assert np.array_equal(image, np.rint(got.rgb * 255).astype(np.uint8))
