from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.logs import DrivingLog, ego_path, even_ground
from recast.reconstruction import TrainingStatus, TrainResult, train_scene
from recast.reconstruction.densify import GroundSheet
from recast.reconstruction.points import read_sweeps
from recast.reconstruction.settings import OPTIM
from recast.reconstruction.train import WORK_FOLDER
from recast.reconstruction.views import choose_actors, read_views
from recast.scene import SceneRasterizer
from recast.scene.store import read_tensors, save_scene, write_tensors
from support.moments import said_on_a_read_only_disk
from support.tiny_street import TINY, KilledError, contents


@pytest.fixture(scope="module")
def stopped(tiny_log: DrivingLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that ended after its first checkpoint."""

    def stop(status: TrainingStatus) -> None:
        if status.iteration >= 20:
            raise KilledError

    folder: Path = tmp_path_factory.mktemp("stopped") / "scene"
    with pytest.raises(KilledError):
        train_scene(tiny_log, folder, TINY, progress=stop)
    return folder


def test_training_raises_held_out_psnr(trained: TrainResult) -> None:
    held_out = [record["held_out_psnr"] for record in trained.history]
    assert [record["iteration"] for record in trained.history] == [20, 40, 60]
    assert held_out[-1] > held_out[0] + 1.0
    assert held_out[-1] > 24.0


def test_moving_and_parked_tracks_become_actors(trained: TrainResult, tiny_log: DrivingLog) -> None:
    assert set(trained.scene.actors) == set(tiny_log.tracks) == {"0", "1"}
    parked = trained.scene.actors["1"].trajectory.poses
    assert set(trained.scene.standing) == {"1"} and np.array_equal(parked[0], parked[1])


def test_who_is_parked_is_drawn_unless_it_is_moved(
    trained: TrainResult, tiny_log: DrivingLog
) -> None:
    view = read_views(tiny_log, TINY)[0]
    scene = trained.scene
    poses = scene.actor_poses(view.timestamp_us)
    moving = {"0": poses["0"]}
    rasterizer = SceneRasterizer(scene, "cpu")
    drawn = [
        rasterizer.render(view.camera, view.camera_from_world, named).rgb
        for named in (poses, moving, {**moving, "1": poses["1"] + _aside(30.0)})
    ]
    assert np.array_equal(drawn[0], drawn[1]) and not np.array_equal(drawn[0], drawn[2])
    assert len(scene.at(moving)) == len(scene.at(poses))


def _aside(metres: float) -> np.ndarray:
    shift = np.zeros((4, 4))
    shift[1, 3] = metres
    return shift


def test_the_road_is_a_sheet(trained: TrainResult, tiny_log: DrivingLog) -> None:
    views = read_views(tiny_log, TINY)
    tracks = choose_actors(tiny_log, views, TINY)
    held_out = [view.timestamp_us for view in views if view.held_out]
    path = ego_path(tiny_log.world_from_rig)
    assert path is not None
    sweeps = read_sweeps(tiny_log, tracks, held_out)
    ground = even_ground((sweep.background.astype(float) for sweep in sweeps), path)
    sheet = GroundSheet(ground, TINY.ground_tolerance_m)
    means = trained.scene.background.means
    above = (means[:, 2] - sheet.surface(means)[0]).abs()
    near = above < OPTIM.ground_reach_m
    assert int(near.sum()) > 100
    assert above[near].max() <= TINY.ground_tolerance_m + 1e-5


def test_progress_is_told(trained: TrainResult, told: list[TrainingStatus]) -> None:
    assert [status.phase for status in told if status.phase != "train"] == [
        "initialise",
        "evaluate",
        "evaluate",
        "evaluate",
        "done",
    ]
    steps = [status for status in told if status.phase == "train"]
    assert [status.iteration for status in steps] == [10, 20, 30, 40, 50, 60]
    assert all(status.loss and status.psnr and status.gaussians for status in steps)
    assert steps[2].held_out_psnr == trained.history[0]["held_out_psnr"]
    assert steps[1].seconds_left is not None


def test_a_killed_run_ends_in_the_same_bytes(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    def kill_at(iteration: int):
        def callback(status: TrainingStatus) -> None:
            if status.iteration >= iteration:
                raise KilledError

        return callback

    folder = tmp_path / "scene"
    with pytest.raises(KilledError):  # before the first checkpoint
        train_scene(tiny_log, folder, TINY, progress=kill_at(10))
    with pytest.raises(KilledError):  # 10 steps after the second one, past a densification
        train_scene(tiny_log, folder, TINY, progress=kill_at(40))
    assert (folder / WORK_FOLDER / "checkpoint.safetensors").is_file()
    first_told: list[int] = []
    train_scene(tiny_log, folder, TINY, progress=lambda status: first_told.append(status.iteration))
    assert first_told[1] == 40  # not from the start
    assert contents(folder) == contents(trained.folder)


@pytest.mark.parametrize("name", ["initialisation", "checkpoint"])
@pytest.mark.parametrize("damage", ["a tensor is gone", "a tensor has another shape", "no header"])
def test_damaged_work_is_one_line(
    tiny_log: DrivingLog, stopped: Path, tmp_path: Path, name: str, damage: str
) -> None:
    folder = Path(shutil.copytree(stopped, tmp_path / "scene"))
    path = folder / WORK_FOLDER / f"{name}.safetensors"
    tensors, header = read_tensors(path)
    tensors = {key: tensor.clone() for key, tensor in tensors.items()}
    key = next(key for key in tensors if key.startswith("background:quats"))
    if damage == "a tensor is gone":
        del tensors[key]
    elif damage == "no header":
        header = {}
    else:
        tensors[key] = tensors[key][:, :3].contiguous()
    write_tensors(path, tensors, header)
    with pytest.raises(
        InputError, match=rf"{name}\.safetensors: state: is not a checkpoint of this version"
    ):
        train_scene(tiny_log, folder, TINY)
    assert not (folder / "scene.json").exists()


def test_a_finished_run_is_loaded_not_trained(trained: TrainResult, tiny_log: DrivingLog) -> None:
    told: list[TrainingStatus] = []
    again = train_scene(tiny_log, trained.folder, TINY, progress=told.append)
    assert told == [] and again.history == trained.history
    assert np.array_equal(again.scene.background.means, trained.scene.background.means)


def test_another_seed_gives_another_scene(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    config = TINY.model_copy(update={"seed": 1, "iterations": 2, "evaluate_every": 2})
    same = train_scene(tiny_log, tmp_path / "a", config.model_copy(update={"seed": 0}))
    other = train_scene(tiny_log, tmp_path / "b", config)
    assert not np.array_equal(same.scene.sky.colours, other.scene.sky.colours)


@pytest.mark.parametrize(
    ("field", "value"), [("iterations", 61), ("voxel_m", 0.5), ("force_dynamic", ("1",))]
)
def test_a_folder_with_another_configuration_is_refused(
    trained: TrainResult, tiny_log: DrivingLog, field: str, value: object
) -> None:
    before = contents(trained.folder)
    with pytest.raises(InputError, match=field):
        train_scene(tiny_log, trained.folder, TINY.model_copy(update={field: value}))
    assert contents(trained.folder) == before


def test_a_folder_of_an_earlier_recipe_is_refused(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    folder = tmp_path / "scene"
    shutil.copytree(trained.folder, folder)
    fields = json.loads((folder / "config.json").read_text())
    del fields["ground_tolerance_m"]
    (folder / "config.json").write_text(json.dumps(fields))
    with pytest.raises(InputError, match=r"config\.json: fields: .*earlier release"):
        train_scene(tiny_log, folder, TINY)


def test_a_folder_of_another_log_is_refused(trained: TrainResult, tiny_log: DrivingLog) -> None:
    with pytest.raises(InputError, match="holds a run of"):
        train_scene(replace(tiny_log, name="x"), trained.folder.parent / "scene", TINY)
    moved = replace(tiny_log, world_offset=tiny_log.world_offset + 1)
    with pytest.raises(InputError, match="in another state"):
        train_scene(moved, trained.folder, TINY)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a read-only disk is tried in a fork")
def test_a_read_only_disk_is_one_line(
    trained: TrainResult, tiny_log: DrivingLog, tmp_path: Path
) -> None:
    """Of every moment of a command, see `test_interrupted`."""
    out = tmp_path / "out"
    out.mkdir()
    for work in (
        lambda: train_scene(tiny_log, out / "scene", TINY),
        lambda: save_scene(trained.scene, out / "copy"),
    ):
        assert "read-only" in said_on_a_read_only_disk(work, out)
    assert list(out.iterdir()) == []


def test_a_folder_with_strangers_is_refused(tiny_log: DrivingLog, tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"x")
    with pytest.raises(InputError, match=r"photo\.jpg"):
        train_scene(tiny_log, tmp_path, TINY)
    assert [path.name for path in tmp_path.iterdir()] == ["photo.jpg"]


def test_no_image_to_train_on(tiny_log: DrivingLog, tmp_path: Path) -> None:
    config = TINY.model_copy(update={"holdout_every": 1, "holdout_offset": 0})
    with pytest.raises(InputError, match="no image to train on"):
        train_scene(tiny_log, tmp_path / "scene", config)


def test_tensors_of_one_memory_are_written_each(tmp_path: Path) -> None:
    whole = torch.arange(12.0).view(6, 2)
    given = {"whole": whole, "top": whole[:2], "again": whole, "turned": whole.T}
    write_tensors(tmp_path / "file", given, {})
    found, _ = read_tensors(tmp_path / "file")
    assert found.keys() == given.keys()
    assert all(torch.equal(found[name], given[name]) for name in given)
