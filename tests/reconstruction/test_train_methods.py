"""All the methods that published trainers bring along, at once, in a run of few steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig, TrainingStatus, TrainResult, train_scene
from recast.reconstruction.views import read_view
from recast.scene import SceneRasterizer, load_scene
from recast.splats import CLASSIC, Rasterization, rasterize
from support.tiny_street import KilledError

EVERYTHING = SceneConfig(
    scale=0.5,
    iterations=24,
    sweep_points=0,
    voxel_m=0.8,
    threads=1,
    seed=3,
    low_pass=CLASSIC,
    sky="cubemap",
    sky_face_px=8,
    sky_loss="entropy",
    sky_weight=0.05,
    fourier_terms=5,
    flip_probability=0.5,
    exposure_lr=1e-3,
    exposure_weight=0.1,
    depth_error="inverse",
    depth_keep=1.0,
    sharp_shape_weight=1.0,
    track_smoothness_weight=0.1,
    actor_opacity_weight=0.1,
    coarse_fraction=0.5,
    coarse_factors=(4, 2),
    densify_every=4,
    densify_growth=10.0,
    densify_from=0.1,
    densify_gradient=1e-6,
    densify_by="absolute_l1",
    actor_densify_by="absolute_norm",
    max_gaussians=3000,
    prune_opacity=0.005,
    prune_above_m=1.0,
    opacity_reset_every=0.4,
    densify_pause=0.5,
    evaluate_every=24,
    checkpoint_every=5,
)


@pytest.fixture(scope="module")
def made(tiny_log: DrivingLog, tmp_path_factory: pytest.TempPathFactory) -> TrainResult:
    return train_scene(tiny_log, tmp_path_factory.mktemp("methods") / "scene", EVERYTHING)


def test_killed_and_resumed_it_ends_in_the_same_bytes(
    made: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    def kill(status: TrainingStatus) -> None:
        if status.iteration == 10:
            raise KilledError

    folder = tmp_path / "scene"
    with pytest.raises(KilledError):
        train_scene(tiny_log, folder, EVERYTHING, progress=kill)
    train_scene(tiny_log, folder, EVERYTHING)
    for path in made.folder.iterdir():
        assert path.read_bytes() == (folder / path.name).read_bytes(), path.name


def test_sizes_of_gradients_are_computed_only_while_they_count(
    tiny_log: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def spy(*arguments: Any, absgrad: bool, **filters: Any) -> Rasterization:
        asked.append(absgrad)
        return rasterize(*arguments, absgrad=absgrad, **filters)

    monkeypatch.setattr("recast.reconstruction.step.rasterize", spy)
    short = EVERYTHING.model_copy(update={"iterations": 4, "densify_until": 0.5})
    train_scene(tiny_log, tmp_path / "absolute", short)
    assert asked == [True, True, False, False]
    asked.clear()
    signed = {"densify_by": "signed", "actor_densify_by": "signed"}
    train_scene(tiny_log, tmp_path / "signed", short.model_copy(update=signed))
    assert asked == [False] * 4


def test_actors_keep_how_their_colours_change(made: TrainResult, tiny_log: DrivingLog) -> None:
    loaded = load_scene(made.folder)
    actor = loaded.actors["0"]
    assert actor.appearance is not None and actor.appearance.frozen_share == 0.5
    assert actor.appearance.fourier.shape == (len(actor.gaussians), 4, 3)
    assert torch.equal(actor.appearance.fourier, made.scene.actors["0"].appearance.fourier)
    assert actor.appearance.fourier.abs().max() > 1e-3

    times = actor.trajectory.timestamps_us
    half = int(times[0] + (times[-1] - times[0]) // 2)
    assert torch.allclose(actor.coloured_at(half).gaussians.sh, actor.gaussians.sh, atol=1e-4)
    view = read_view(tiny_log, tiny_log.cameras["image_02"], 1, 0.5)
    poses = loaded.actor_poses(view.timestamp_us)
    rasterizer = SceneRasterizer(loaded)

    def drawn(colours_us: int | None) -> np.ndarray:
        return rasterizer.render(view.camera, view.camera_from_world, poses, colours_us).rgb

    assert np.abs(drawn(half) - drawn(None)).max() < 1e-3
    assert np.abs(drawn(int(times[0])) - drawn(None)).max() > 1e-3


def test_the_sky_is_saved_as_a_panorama(made: TrainResult) -> None:
    assert made.scene.sky.colours.shape == (16, 32, 3)
