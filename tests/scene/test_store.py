from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.errors import InputError
from recast.scene import SceneActor, StreetScene, TrainResult, load_scene, save_scene
from recast.scene.trainable import rows
from recast.splats import Gaussians


def same(first: Gaussians, second: Gaussians) -> bool:
    return all(
        torch.equal(a, b) for a, b in zip(rows(first).values(), rows(second).values(), strict=True)
    )


def with_shadow(scene: StreetScene) -> StreetScene:
    actor = scene.actors["0"]
    shadow = actor.gaussians.select(torch.arange(5))
    shadow = replace(shadow, sh=shadow.sh[:, :1])
    twin: SceneActor = replace(actor, track_id="new/car", shadow=shadow)
    return scene.with_actor(twin)


def test_round_trip_is_exact(trained: TrainResult, tmp_path: Path) -> None:
    scene = with_shadow(trained.scene)
    save_scene(scene, tmp_path / "scene")
    loaded = load_scene(tmp_path / "scene")
    assert same(loaded.background, scene.background)
    assert list(loaded.actors) == ["0", "new/car"]
    for track_id, actor in loaded.actors.items():
        before = scene.actors[track_id]
        assert same(actor.gaussians, before.gaussians)
        assert np.array_equal(actor.size, before.size)
        assert np.array_equal(actor.trajectory.poses, before.trajectory.poses)
        assert np.array_equal(actor.trajectory.timestamps_us, before.trajectory.timestamps_us)
    shadow = loaded.actors["new/car"].shadow
    assert shadow is not None and same(shadow, scene.actors["new/car"].shadow)  # type: ignore[arg-type]
    assert loaded.actors["0"].shadow is None
    assert torch.equal(loaded.sky.colours, scene.sky.colours)
    assert np.array_equal(loaded.world_offset, scene.world_offset)
    for name, (times, twists) in scene.camera_corrections.items():
        assert np.array_equal(loaded.camera_corrections[name][0], times)
        assert np.array_equal(loaded.camera_corrections[name][1], twists)
    assert loaded.log_name == scene.log_name


def test_a_scene_is_not_written_over(trained: TrainResult) -> None:
    with pytest.raises(InputError, match="holds a scene already"):
        save_scene(trained.scene, trained.folder)


@pytest.fixture
def folder(trained: TrainResult, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained.folder, tmp_path / "copy"))


def test_no_scene_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scene\.json"):
        load_scene(tmp_path)


def test_another_version(folder: Path) -> None:
    record = json.loads((folder / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps({**record, "version": 2}))
    with pytest.raises(InputError, match="is 2, this recast reads 1"):
        load_scene(folder)


@pytest.mark.parametrize("member", ["background.ply", "actor_000_0.ply", "scene.safetensors"])
def test_a_missing_member_is_named(folder: Path, member: str) -> None:
    (folder / member).unlink()
    with pytest.raises(InputError, match=member):
        load_scene(folder)


def test_a_cut_tensor_file(folder: Path) -> None:
    path = folder / "scene.safetensors"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="cannot be read"):
        load_scene(folder)


def test_a_field_of_the_wrong_kind(folder: Path) -> None:
    record = json.loads((folder / "scene.json").read_text())
    record["actors"][0]["size"] = "big"
    (folder / "scene.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="size"):
        load_scene(folder)
