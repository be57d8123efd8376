from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import read_log
from recast.scene import load_scene, render_scene
from recast_bridges.scenes import hugsim_log, import_hugsim, import_hugsim_with_log
from support import trained_scenes as made
from support.hugsim_scenes import (
    BACK,
    FIRST,
    FORWARD_DOWN_LEFT,
    RIGHT_FORWARD_UP,
    SCENE_FROM_WORLD,
    background,
    in_own_axes,
    make_ground,
    make_log,
    members,
    own_pose,
    unicycle,
    write,
)


def published(frame: float, with_actors: bool) -> np.ndarray:
    """The image (H, W, 3) that the published renderer draws: a readable reference.

    Harmonics are looked up in the scene's axes, whichever way an actor is turned.
    """
    camera = made.camera_from_world(frame) @ se3.inverse(SCENE_FROM_WORLD)
    parts = [background(), make_ground()]
    if with_actors:
        for true, axes, seed in (
            (made.world_from_car, RIGHT_FORWARD_UP, 3),
            (made.world_from_parked, FORWARD_DOWN_LEFT, 2),
        ):
            parts.append(made.moved(in_own_axes(seed, axes), own_pose(true(frame), axes), True))
    return made.rasterized(parts, camera).rgb.numpy().clip(0, 1)


@pytest.mark.parametrize("tracks", [True, False])
def test_the_import_draws_what_the_published_renderer_draws(tmp_path: Path, tracks: bool) -> None:
    log = make_log(tracks)
    folder = write(tmp_path / "street")
    record = import_hugsim(folder, log, tmp_path / "scene", first_frame=FIRST, share=1.0)
    scene = load_scene(tmp_path / "scene")
    assert record.iteration == 30000 and record.layout == "hugsim"
    assert record.placed_by.startswith("the pose of front at 1000100000 us; its camera is 0.00 m")
    names = {"12": made.CAR, "7": made.PARKED} if tracks else {}
    assert record.tracks == names and not record.warnings
    assert set(scene.actors) == (set(names.values()) if tracks else {"12", "7"})
    assert np.allclose(record.world_from_scene, se3.inverse(SCENE_FROM_WORLD), rtol=0, atol=1e-9)
    last = made.FRAMES - 1  # at the end of its time the moving car's harmonics agree
    camera, poses = made.camera_from_world(last), scene.actor_poses(int(made.TIMES[last]))
    with_actors = render_scene(scene, made.CAMERA, camera, poses).rgb
    # float32 places of 30 m and turned harmonics: 1e-4 of a colour.
    assert np.abs(with_actors - published(last, True)).max() < 5e-4
    moved = replace(scene, actors={})
    without = render_scene(moved, made.CAMERA, camera, {}).rgb
    assert np.abs(without - published(last, False)).max() < 5e-4
    assert np.abs(with_actors - without).max() > 0.1
    for name, true in (("12", made.world_from_car), ("7", made.world_from_parked)):
        actor = scene.actors[names.get(name, name)]
        if tracks or name == "12":  # forward, left and up, though the files have other axes
            assert np.allclose(actor.trajectory.poses[-1], true(last), rtol=0, atol=1e-6)
    if not tracks:
        assert any(line.startswith("7: hardly move") for line in record.changed)
        assert np.allclose(scene.actors["12"].size, [3.9, 1.6, 1.4], rtol=0, atol=0.2)


def test_what_is_not_carried_over_is_told(tmp_path: Path) -> None:
    folder = write(tmp_path / "street")
    (folder / "unicycle_7.pth").unlink()
    record = import_hugsim(
        folder, make_log(), tmp_path / "scene", first_frame=FIRST, leave_out=("12",)
    )
    assert not load_scene(tmp_path / "scene").actors
    for line in (
        "actor 12: left out as requested",
        "actor 7: has no unicycle_7.pth",
        "feats3D",
        "appearance",
    ):
        assert any(one.startswith(line) for one in record.left_out), line


def test_the_camera_and_the_place_can_be_named(tmp_path: Path) -> None:
    folder, log = write(tmp_path / "street"), make_log()
    record = import_hugsim(folder, log, tmp_path / "a", camera="back", first_frame=FIRST)
    assert "m beside the path of back" in record.warnings[0]
    place = tmp_path / "place.txt"
    np.savetxt(place, se3.inverse(SCENE_FROM_WORLD))
    record = import_hugsim(folder, log, tmp_path / "b", world_from_scene=place, first_frame=FIRST)
    assert record.placed_by.startswith("as given in place.txt; its camera is 0.00 m")
    with pytest.raises(InputError, match="camera 'left': is not a camera of the log"):
        import_hugsim(folder, log, tmp_path / "c", camera="left")
    with pytest.raises(InputError, match="front has frames 0 to 10"):
        import_hugsim(folder, log, tmp_path / "c", first_frame=11)
    with pytest.raises(InputError, match="time_unit"):
        import_hugsim(folder, log, tmp_path / "c", time_unit=0.0)


def test_a_scene_in_another_frame_is_warned_of(tmp_path: Path) -> None:
    folder = write(tmp_path / "street")
    place = tmp_path / "place.txt"
    moved = se3.inverse(SCENE_FROM_WORLD)
    moved[1, 3] += 3
    np.savetxt(place, moved)
    record = import_hugsim(
        folder, make_log(), tmp_path / "b", world_from_scene=place, first_frame=FIRST
    )
    assert any("m beside the path of front" in line for line in record.warnings)


def test_a_log_is_made_of_the_files_of_the_street(tmp_path: Path) -> None:
    folder = write(tmp_path / "street")
    record = import_hugsim_with_log(folder, tmp_path / "log", tmp_path / "own")
    assert record.tracks == {"12": "12", "7": "7"} and not record.warnings
    log, scene = read_log(tmp_path / "log"), load_scene(tmp_path / "own")
    assert list(log.world_from_rig.timestamps_us) == [100_000 * k for k in range(10)]
    assert set(log.cameras) == {"CAM_FRONT", "CAM_BACK"} and log.name == "street"
    mounts = {name: one.rig_from_camera for name, one in log.cameras.items()}
    # The rig is below the front camera, 1.5 m above the ground in the files.
    shift = se3.from_rotation_translation(np.eye(3), made.RIG_FROM_CAMERA[:3, 3] - [0, 0, 1.5])
    for name, mount in (("CAM_FRONT", made.RIG_FROM_CAMERA), ("CAM_BACK", BACK)):
        assert np.allclose(mounts[name], se3.inverse(shift) @ mount, rtol=0, atol=1e-6)
        assert np.allclose(log.cameras[name].camera.matrix, made.CAMERA.matrix)
    world_from_true = se3.inverse(made.world_from_rig(FIRST) @ shift)
    for frame in (FIRST, 6, made.FRAMES - 1):
        time = 100_000 * (frame - FIRST)
        ego = world_from_true @ made.world_from_rig(frame) @ shift
        assert np.allclose(log.world_from_rig.at(time), ego, rtol=0, atol=1e-6)
        car = world_from_true @ made.world_from_car(frame)
        assert np.allclose(log.tracks["12"].trajectory.at(time), car, rtol=0, atol=1e-6)
        assert np.allclose(scene.actor_poses(time)["12"], car, rtol=0, atol=1e-6)
    last = made.FRAMES - 1
    camera = made.camera_from_world(last) @ se3.inverse(world_from_true)
    drawn = render_scene(replace(scene, actors={}), made.CAMERA, camera, {}).rgb
    assert np.abs(drawn - published(last, False)).max() < 5e-4


def test_the_unit_of_times_stretches_the_drive(tmp_path: Path) -> None:
    log = hugsim_log(write(tmp_path / "street"), time_unit=0.5)
    assert list(log.world_from_rig.timestamps_us[[0, -1]]) == [0, 450_000]
    assert list(log.tracks["12"].trajectory.timestamps_us[[0, -1]]) == [0, 450_000]


IMAGE = {
    "rgb_path": "a/b.jpg",
    "camtoworld": np.eye(4).tolist(),
    "intrinsics": made.CAMERA.matrix.tolist(),
    "width": 64,
    "height": 40,
    "timestamp": 0,
}


@pytest.mark.parametrize(
    ("meta", "line"),
    [
        ({"frames": []}, "frames: is not a list, or empty"),
        ({"frames": [3]}, r"frames\[0\]: is not a table"),
        ({"frames": [IMAGE | {"timestamp": "x"}]}, r"frames\[0\]\.timestamp: is str"),
        ({"frames": [IMAGE | {"camtoworld": [[1, 2]]}]}, r"camtoworld: has shape \[1, 1, 2\]"),
        ({"frames": [IMAGE | {"intrinsics": [1, 2]}]}, "intrinsics: or width or height"),
        ({"frames": [IMAGE | {"rgb_path": 3}]}, "rgb_path: is int, not a text"),
        ({"frames": [IMAGE, IMAGE]}, "camera a: has two images at one time"),
        ({"frames": [IMAGE]}, "camera a: has fewer than two images"),
    ],
)
def test_a_log_of_broken_files_is_not_written(tmp_path: Path, meta: Any, line: str) -> None:
    folder = write(tmp_path / "street", meta=meta)
    with pytest.raises(InputError, match=line):
        import_hugsim_with_log(folder, tmp_path / "log", tmp_path / "scene")
    with pytest.raises(InputError, match="ghost"):  # after the log was written
        import_hugsim_with_log(
            write(tmp_path / "b"), tmp_path / "log", tmp_path / "scene", leave_out=("ghost",)
        )
    assert not (tmp_path / "log").exists() and not (tmp_path / "scene").exists()


def test_scenes_as_they_were_saved_at_first_are_read(tmp_path: Path) -> None:
    training = (torch.zeros(300), torch.zeros(300, 1), torch.zeros(300, 1), {"state": {}})
    flat = members(make_ground(), [0, 2])
    scene = (*members(background()), *training, 1.0, {}, flat)
    import_hugsim(write(tmp_path / "old", scene), make_log(), tmp_path / "a", first_frame=FIRST)
    import_hugsim(write(tmp_path / "new"), make_log(), tmp_path / "b", first_frame=FIRST)
    old, new = load_scene(tmp_path / "a"), load_scene(tmp_path / "b")
    assert torch.equal(old.background.means, new.background.means)
    bare = (*members(background()), 1.0, {}, None)
    import_hugsim(write(tmp_path / "bare", bare), make_log(), tmp_path / "c", first_frame=FIRST)
    assert len(load_scene(tmp_path / "c").background) == len(new.background) - 90


class Hostile:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_code_in_the_files_is_not_run(tmp_path: Path) -> None:
    hostile = Hostile(tmp_path / "ran")
    for index, folder in enumerate(
        [
            write(tmp_path / "1", scene=(*members(background()), 1.0, hostile, None)),
            write(tmp_path / "2", commands=[hostile]),
            write(tmp_path / "3", car=(*members(make_ground()), hostile)),
            write(tmp_path / "4", motion=(hostile,) * 8),
        ]
    ):
        with pytest.raises(InputError, match=r"mkdir, which is (not a tensor and is )?never"):
            import_hugsim(folder, make_log(), tmp_path / f"out{index}", first_frame=FIRST)
        assert not (tmp_path / f"out{index}").exists()
    assert not (tmp_path / "ran").exists()


def changed(index: int, value: Any) -> tuple[Any, ...]:
    own = [*members(background()), 1.0, {}, None]
    own[index] = value
    return tuple(own)


MOTION = unicycle(np.stack([np.eye(4)] * 3), np.arange(3.0))


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"scene": 3}, "Gaussians: is not a tuple of 8 members"),
        ({"scene": changed(0, 4)}, "active_sh_degree: is 4, expected 0 to 3"),
        ({"scene": changed(0, True)}, "active_sh_degree: is bool, not a number"),
        ({"scene": changed(3, torch.zeros(300, 8, 3))}, "features_rest: has 8 harmonics"),
        ({"scene": changed(5, torch.zeros(300, 2))}, r"scaling: has shape \[300, 2\]"),
        ({"scene": changed(1, torch.full((300, 3), torch.nan))}, "xyz: is not finite"),
        ({"ground": (1, 2)}, "ground: is not a tuple"),
        ({"ground": members(make_ground())}, r"ground\.scaling: has shape \[90, 3\]"),
        ({"car": (1, 2)}, "Gaussians: is not a tuple"),
        ({"motion": MOTION[:5]}, "is not a tuple of 8 members"),
        ({"motion": (*MOTION[:4], MOTION[4] * torch.nan, *MOTION[5:])}, "yaw: has no 3 values"),
        ({"motion": (*MOTION[:6], torch.zeros(3), MOTION[7])}, "train_timestamp: are not times"),
        ({"motion": (MOTION[0][:2], *MOTION[1:])}, "a: has no 3 values"),
        ({"poses": np.zeros((2, 3, 4))}, r"cam_poses: has shape \[2, 3, 4\]"),
        ({"poses": 2 * np.eye(4)[None]}, "cam_poses: holds a matrix that is not a pose"),
        ({"poses": np.diag([1.0, -1, 1, 1])[None]}, "cam_poses: holds a mirrored pose"),
    ],
)
def test_broken_scenes_are_refused_by_member(
    tmp_path: Path, changes: dict[str, Any], line: str
) -> None:
    folder = write(tmp_path / "street", **changes)
    with pytest.raises(InputError, match=line):
        import_hugsim(folder, make_log(), tmp_path / "scene", first_frame=FIRST)
    assert not (tmp_path / "scene").exists()
