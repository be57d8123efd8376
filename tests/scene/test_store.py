from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from recast.core.errors import InputError
from recast.reconstruction import TrainResult
from recast.scene import SceneActor, StreetScene, load_scene, save_scene
from recast.scene.store import read_tensors, write_tensors
from recast.splats import MIP
from support.tiny_street import same


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
    assert list(loaded.actors) == ["0", "1", "new/car"]
    for track_id, actor in loaded.actors.items():
        before = scene.actors[track_id]
        assert same(actor.gaussians, before.gaussians)
        assert actor.low_pass == before.low_pass
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
    assert loaded.low_pass == scene.low_pass == MIP
    assert loaded.mounts.keys() == scene.camera_corrections.keys()
    for name, moved in scene.mounts.items():
        assert np.array_equal(loaded.mounts[name], moved)
    assert loaded.exposures.keys() == scene.exposures.keys() == scene.camera_corrections.keys()
    for name, (times, affines) in scene.exposures.items():
        assert np.array_equal(loaded.exposures[name][0], times)
        assert np.array_equal(loaded.exposures[name][1], affines)


def test_a_scene_is_not_written_over(trained: TrainResult) -> None:
    with pytest.raises(InputError, match="already holds a scene"):
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


def edit(folder: Path, **members: object) -> None:
    record = json.loads((folder / "scene.json").read_text())
    actor = members.pop("actor", {})
    record.update(members)
    record["actors"][0].update(actor)
    (folder / "scene.json").write_text(json.dumps(record))


@pytest.mark.parametrize("name", ["../elsewhere.ply", "/etc/passwd", "a\0b", "", "..\\x", "C:x"])
@pytest.mark.parametrize("field", ["background", "tensors", "gaussians", "shadow"])
def test_a_record_names_nothing_outside_of_its_folder(folder: Path, field: str, name: str) -> None:
    shutil.copy(folder / "background.ply", folder.parent / "elsewhere.ply")
    edit(
        folder,
        **({field: name} if field in ("background", "tensors") else {"actor": {field: name}}),
    )
    with pytest.raises(InputError, match=f"{field}: names .*not a file inside of copy/"):
        load_scene(folder)


def tensors_with(folder: Path, name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> None:
    tensors, header = read_tensors(folder / "scene.safetensors")
    tensors = {key: tensor.clone() for key, tensor in tensors.items()}
    tensors[name] = change(tensors[name])
    write_tensors(folder / "scene.safetensors", tensors, header)


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("sky", lambda t: t * torch.nan, "sky: holds a colour outside"),
        ("sky", lambda t: t + torch.inf, "sky: holds a colour outside"),
        ("sky", lambda t: t - 1.5, "sky: holds a colour outside"),
        ("sky", lambda t: t[..., :2], r"sky: expected \(H, W, 3\)"),
        ("sky", lambda t: t.half(), "sky: is of torch.float16"),
        ("sky", lambda t: t[:0], r"sky: expected \(H, W, 3\)"),
        ("actor/0/poses", lambda t: t * 2, "not a rotation|last row"),
        ("actor/0/poses", lambda t: t * torch.nan, "nan is not within"),
        ("actor/0/poses", lambda t: t[:-1], "poses: expected"),
        ("actor/0/poses", lambda t: t.bfloat16(), "is of torch.bfloat16"),
        ("actor/0/timestamps_us", lambda t: t.flip(0), "increase strictly"),
        ("camera/image_02/twists", lambda t: t * torch.nan, "not finite"),
        ("camera/image_02/twists", lambda t: t[:, :5], "twists"),
        ("camera/image_02/timestamps_us", lambda t: t.flip(0), "increase strictly"),
    ],
)
def test_values_that_no_scene_has(
    folder: Path, name: str, change: Callable[[torch.Tensor], torch.Tensor], problem: str
) -> None:
    camera = json.loads((folder / "scene.json").read_text())["cameras"][0]
    tensors_with(folder, name.replace("image_02", camera), change)
    with pytest.raises(InputError, match=problem) as caught:
        load_scene(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    ("members", "problem"),
    [
        ({"actor": {"size": [4, -2, 1]}}, "size: three metres"),
        ({"actor": {"size": [4, 0, 1]}}, "size: three metres"),
        ({"actor": {"size": [4, 1e300, 1]}}, "size: three metres"),
        ({"world_offset": [1e308, "x", 0]}, "world_offset"),
    ],
)
def test_numbers_that_no_scene_has(folder: Path, members: dict[str, object], problem: str) -> None:
    edit(folder, **members)
    with pytest.raises(InputError, match=problem):
        load_scene(folder)


def test_a_track_stands_once(folder: Path) -> None:
    record = json.loads((folder / "scene.json").read_text())
    edit(folder, actors=record["actors"] * 2)
    with pytest.raises(InputError, match="name a track twice"):
        load_scene(folder)


def test_an_invalid_scene_is_not_written(trained: TrainResult, tmp_path: Path) -> None:
    actor = trained.scene.actors["0"]
    wrong = trained.scene.with_actor(replace(actor, size=np.array([4.0, np.nan, 1.5])))
    with pytest.raises(ValueError, match=r"actors\['0'\]\.size"):
        save_scene(wrong, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def test_a_header_of_many_brackets(folder: Path) -> None:
    tensors, _ = read_tensors(folder / "scene.safetensors")
    path = folder / "scene.safetensors"
    save_file({k: t.clone() for k, t in tensors.items()}, path, {"recast": "[" * 10_000})
    with pytest.raises(InputError, match="nested too deeply"):
        load_scene(folder)
    save_file({k: t.clone() for k, t in tensors.items()}, path, {"recast": "9" * 10_000})
    with pytest.raises(InputError, match=r"cannot be read|no object"):
        load_scene(folder)


def test_a_name_that_is_too_long(folder: Path) -> None:
    edit(folder, tensors="A" * 300)
    with pytest.raises(InputError, match="too long a name"):
        load_scene(folder)
