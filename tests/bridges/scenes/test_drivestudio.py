from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.logs import DrivingLog
from recast.scene import load_scene, render_scene
from recast_bridges.scenes import import_drivestudio
from support import trained_scenes as made
from support.drivestudio_scenes import (
    COUNT,
    FIRST,
    SCENE_FROM_WORLD,
    SKY_FROM_SCENE,
    WORLD_FROM_SCENE,
    checkpoint,
    mean_affine,
    scene_from_instance,
)


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return made.make_log()


def save(path: Path, content: Any) -> Path:
    torch.save(content, path)
    return path


def test_the_import_draws_what_the_checkpoint_draws(log: DrivingLog, tmp_path: Path) -> None:
    path = save(tmp_path / "checkpoint_final.pth", checkpoint())
    record = import_drivestudio(path, log, tmp_path / "scene", first_frame=FIRST)
    assert record.tracks == {"0": made.PARKED, "1": made.CAR} and record.iteration == 30000
    assert any("0.19 m off at most" in line for line in record.changed)
    for start in ("DeformableNodes", "SMPLNodes", "CamPose", "Affine"):
        assert any(line.startswith(start) for line in record.left_out), start
    scene = load_scene(tmp_path / "scene")
    assert list(scene.actors[made.CAR].trajectory.timestamps_us) == list(made.TIMES[FIRST + 1 :])
    # In the middle of the moving car's time its colours agree.
    frame = (FIRST + 1 + made.FRAMES - 1) // 2
    assert (FIRST + 1 + made.FRAMES - 1) % 2 == 1  # half-way between two frames
    middle = (made.TIMES[frame] + made.TIMES[frame + 1]) // 2
    pose = scene.actors[made.CAR].trajectory.at(middle)
    scene_from_car = SCENE_FROM_WORLD @ pose
    background = made.moved(made.make_background(3), SCENE_FROM_WORLD, False)
    parts = [
        background,
        made.moved(made.make_car(3, 2), scene_from_instance(0, frame), True),
        made.moved(made.make_car(3, 3), scene_from_car, True),
    ]
    camera = made.camera_from_world(frame)
    drawn = made.draw(parts, camera @ WORLD_FROM_SCENE, SKY_FROM_SCENE)
    affine = mean_affine()
    expected = drawn @ affine[:, :3].T + affine[:, 3]
    image = render_scene(scene, made.CAMERA, camera, scene.actor_poses(middle))
    assert np.abs(image.rgb - expected.clip(0, 1)).max() < 4e-3
    assert np.abs(expected - drawn).max() > 0.02  # the affine colours show
    assert np.abs(image.rgb - render_scene(scene, made.CAMERA, camera, {}).rgb).max() > 0.1


def test_the_processed_folder_places_the_scene(log: DrivingLog, tmp_path: Path) -> None:
    path = save(tmp_path / "a.pth", checkpoint())
    pose = made.world_from_rig(FIRST)
    pose[:3, 3] += made.OFFSET
    for member in ("ego_pose/002.txt", "extrinsics/002_0.txt"):
        folder = tmp_path / member.split("/")[0] / "drive"
        (folder / member).parent.mkdir(parents=True)
        np.savetxt(folder / member, pose)
        out = tmp_path / f"scene-{folder.parent.name}"
        record = import_drivestudio(path, log, out, first_frame=FIRST, processed=folder)
        assert np.allclose(record.world_from_scene, WORLD_FROM_SCENE, atol=1e-9)
        assert member in record.placed_by


def test_actors_can_be_named_or_left_out(log: DrivingLog, tmp_path: Path) -> None:
    path, names = save(tmp_path / "a.pth", checkpoint()), tmp_path / "tracks.json"
    names.write_text(json.dumps({"1": made.PARKED}))  # against all appearance
    record = import_drivestudio(
        path, log, tmp_path / "scene", first_frame=FIRST, tracks=names, leave_out=("0",)
    )
    assert record.tracks == {"1": made.PARKED}
    assert "actor 0: left out as requested" in record.left_out
    with pytest.raises(InputError, match="actor 9: is not in the checkpoint"):
        import_drivestudio(path, log, tmp_path / "b", first_frame=FIRST, leave_out=("9",))


def test_an_actor_that_is_no_track_is_refused(log: DrivingLog, tmp_path: Path) -> None:
    path, place = save(tmp_path / "a.pth", checkpoint()), tmp_path / "place.txt"
    place.write_text("5 0 0")
    with pytest.raises(InputError, match=r"actor 0 is not a track of log drive: car-. is nearest"):
        import_drivestudio(path, log, tmp_path / "scene", first_frame=FIRST, world_from_scene=place)
    assert not (tmp_path / "scene").exists()


def test_the_wrong_first_frame_shows(log: DrivingLog, tmp_path: Path) -> None:
    path = save(tmp_path / "a.pth", checkpoint())
    record = import_drivestudio(path, log, tmp_path / "scene", first_frame=FIRST - 1)
    assert any("as far as 0.7" in line for line in record.warnings)


def test_a_scene_in_another_frame_is_warned_of(log: DrivingLog, tmp_path: Path) -> None:
    path, place = save(tmp_path / "a.pth", checkpoint(RigidNodes=None)), tmp_path / "place.txt"
    place.write_text("[100, 0, 0]")
    record = import_drivestudio(path, log, tmp_path / "scene", world_from_scene=place)
    assert record.drive_inside == 0 and "different frames" in record.warnings[0]


def broken(part: str, key: str, value: Any) -> dict[str, Any]:
    content = checkpoint()
    content["models"][part] = dict(content["models"][part])
    if value is None:
        del content["models"][part][key]
    else:
        content["models"][part][key] = value
    return content


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ({"step": 3}, "models: is missing"),
        (checkpoint(Background=None), r"models\.Background: is missing"),
        (broken("Background", "_scales", None), r"models\.Background\._scales: is missing"),
        (
            broken("RigidNodes", "points_ids", torch.full((160, 1), 3)),
            "names an actor that is not one of",
        ),
        (broken("RigidNodes", "instances_fv", torch.ones(COUNT, 2)), r"instances_fv: has shape"),
        (broken("RigidNodes", "instances_size", torch.zeros(3, 3)), "instances_size: of actor 0"),
        (
            broken("RigidNodes", "instances_quats", torch.zeros(COUNT, 3, 4)),
            "instances_quats: holds a quaternion of norm zero",
        ),
        (broken("Affine", "decoder.2.weight", torch.zeros(9, 64)), r"decoder\.2\.weight: has"),
        (broken("Sky", "base", torch.full((6, 4, 4, 3), torch.nan)), r"Sky\.base: is not finite"),
    ],
)
def test_broken_checkpoints_are_refused_by_key(
    log: DrivingLog, tmp_path: Path, content: Any, line: str
) -> None:
    path = save(tmp_path / "a.pth", content)
    with pytest.raises(InputError, match=line):
        import_drivestudio(path, log, tmp_path / "scene", first_frame=FIRST)
    assert not (tmp_path / "scene").exists()


def test_frames_that_the_log_does_not_have(log: DrivingLog, tmp_path: Path) -> None:
    path = save(tmp_path / "a.pth", checkpoint())
    with pytest.raises(InputError, match="has 9 frames, the log 7"):
        import_drivestudio(path, log, tmp_path / "scene", first_frame=4)
    with pytest.raises(InputError, match="frame 11: lidar has frames 0 to 10"):
        import_drivestudio(path, log, tmp_path / "scene", first_frame=11)
    with pytest.raises(InputError, match="clock 'radar': is not a sensor"):
        import_drivestudio(path, log, tmp_path / "scene", clock="radar")
