from __future__ import annotations

import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene import load_scene, render_scene
from recast_bridges.scenes import import_street_gaussians
from recast_bridges.scenes.street_gaussians import assign_slots, frozen_constant
from support import trained_scenes as made
from support.street_gaussians_scenes import FOURIER, ROWS, WORLD_FROM_SCENE, checkpoint, fourier

NAMES, STAMPS = ("FRAME", "FRONT"), [f"{frame:06d}" for frame in range(made.FRAMES)]


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return made.make_log()


def save(path: Path, content: Any) -> Path:
    torch.save(content, path)
    return path


@pytest.fixture
def processed(tmp_path: Path) -> Path:
    made.write_street_gaussians_folder(tmp_path / "processed", ROWS)
    return tmp_path / "processed"


def test_the_import_draws_what_the_checkpoint_draws(
    log: DrivingLog, processed: Path, tmp_path: Path
) -> None:
    path = save(tmp_path / "iteration_30000.pth", checkpoint())
    record = import_street_gaussians(path, log, tmp_path / "scene", processed=processed)
    assert record.tracks == {"obj_003": made.CAR} and record.iteration == 30000
    assert not record.warnings and record.left_out == []
    scene = load_scene(tmp_path / "scene")
    trajectory = scene.actors[made.CAR].trajectory
    middle = made.MIDDLE
    time = int(trajectory.timestamps_us[middle])
    # Colours as the layout has them: in scene axes, at half the Fourier time.
    t = 0.5
    basis = [
        1,
        math.sin(2 * math.pi * t),
        math.cos(2 * math.pi * t),
        math.sin(4 * math.pi * t),
        math.cos(4 * math.pi * t),
    ]
    car = made.make_car(1)
    car.sh[:, 0] = sum(b * fourier()[:, k] for k, b in enumerate(basis))
    scene_from_world = se3.inverse(WORLD_FROM_SCENE)
    # The box is placed by the ego pose at the camera's time: in the vehicle frame between labels.
    boxes = [
        se3.inverse(made.world_from_rig(f)) @ made.world_from_car(f) for f in (middle, middle + 1)
    ]
    box = se3.from_rotation_translation(
        boxes[0][:3, :3], 0.6 * boxes[0][:3, 3] + 0.4 * boxes[1][:3, 3]
    )
    pose = scene_from_world @ made.world_from_rig(middle + 0.4) @ box
    assert np.allclose(trajectory.at(time), WORLD_FROM_SCENE @ pose, atol=1e-6)
    background = made.moved(made.make_background(1), scene_from_world, True)
    camera = made.camera_from_world(middle)
    expected = made.draw(
        [background, made.moved(car, pose, True)], camera @ WORLD_FROM_SCENE, np.eye(3)
    )
    image = render_scene(scene, made.CAMERA, camera, scene.actor_poses(time))
    assert np.abs(image.rgb - expected.clip(0, 1)).max() < 4e-3
    empty = render_scene(scene, made.CAMERA, camera, {})
    assert np.abs(image.rgb - empty.rgb).max() > 0.1  # the car is in the picture


def test_learned_corrections_are_read_as_the_trainer_reads_them(
    log: DrivingLog, processed: Path, tmp_path: Path
) -> None:
    generator = torch.Generator().manual_seed(3)
    trans = 0.1 * torch.randn(made.FRAMES, 1, 3, generator=generator)
    rots = 0.05 * torch.randn(made.FRAMES, 1, 1, generator=generator)
    content = checkpoint(actor_pose={"params": {"opt_trans": trans, "opt_rots": rots}})
    path = save(tmp_path / "a.pth", content)
    import_street_gaussians(path, log, tmp_path / "scene", processed=processed)
    poses = load_scene(tmp_path / "scene").actors[made.CAR].trajectory.poses
    frame = 4
    boxes = [se3.inverse(made.world_from_rig(f)) @ made.world_from_car(f) for f in (4, 5)]
    place = 0.6 * (boxes[0][:3, 3] + trans[4, 0].numpy()) + 0.4 * (
        boxes[1][:3, 3] + trans[5, 0].numpy()
    )
    yaw = se3.yaw(boxes[0]) + 2 * float(rots[4]) + 0.4 * 2 * float(rots[4])
    box = se3.from_rotation_translation(se3.rotation_z(yaw), place)
    assert np.allclose(poses[frame], made.world_from_rig(4.4) @ box, atol=1e-6)


def test_without_the_folder_actors_follow_the_log(log: DrivingLog, tmp_path: Path) -> None:
    names = tmp_path / "tracks.json"
    names.write_text(json.dumps({"obj_003": made.CAR}))
    path = save(tmp_path / "a.pth", checkpoint())
    record = import_street_gaussians(path, log, tmp_path / "scene", tracks=names)
    scene = load_scene(tmp_path / "scene")
    assert np.array_equal(
        scene.actors[made.CAR].trajectory.poses, log.tracks[made.CAR].trajectory.poses
    )
    assert any(line.startswith("actor_pose") for line in record.left_out)
    assert "only approximates" in record.placed_by
    assert np.allclose(record.world_from_scene, WORLD_FROM_SCENE, atol=1e-6)
    assert "obj_003" in next(line for line in record.changed if "frozen" in line)


def test_centres_of_float64_are_placed_before_they_are_rounded(
    log: DrivingLog, tmp_path: Path
) -> None:
    """A checkpoint of a world in survey coordinates."""
    offset = torch.tensor([458123.25, 5428765.5, 112.0], dtype=torch.float64)
    content = checkpoint(obj_003=None, actor_pose=None)
    means = made.make_background(1).means
    content["background"]["xyz"] = means.double() + offset
    (tmp_path / "offset.txt").write_text(" ".join(str(-value) for value in offset.tolist()))
    path = save(tmp_path / "a.pth", content)
    import_street_gaussians(path, log, tmp_path / "out", world_from_scene=tmp_path / "offset.txt")
    np.testing.assert_allclose(load_scene(tmp_path / "out").background.means, means, atol=1e-5)


def test_what_cannot_be_carried_over_is_named(
    log: DrivingLog, processed: Path, tmp_path: Path
) -> None:
    content = checkpoint(
        sky_cubemap=None,
        color_correction={"params": {"affine_trans": torch.zeros(4, 3, 4)}},
        pose_correction={"params": {"pose_correction_trans": torch.zeros(4, 3)}},
        obj_009=made.street_gaussians_part(made.make_car(1)),
        novelty={"x": torch.zeros(2)},
    )
    content["background"] |= {"semantic": torch.zeros(300, 19), "optimizer": {"state": {}}}
    path = save(tmp_path / "a.pth", content)
    record = import_street_gaussians(
        path, log, tmp_path / "scene", processed=processed, leave_out=("obj_009",)
    )
    assert "in the models: optimizer, semantic" in record.left_out
    for start in ("obj_009", "color_correction", "pose_correction", "sky", "novelty"):
        assert any(line.startswith(start) for line in record.left_out), start
    kept = json.loads((tmp_path / "scene" / "import.json").read_text())
    assert kept["left_out"] == record.left_out


def test_fourier_basis_begins_as_published() -> None:
    one = torch.eye(FOURIER)[None].expand(3, FOURIER, FOURIER).permute(1, 2, 0)
    values = frozen_constant(one.contiguous(), 0.1)[:, 0]
    expected = [
        1,
        math.sin(0.2 * math.pi),
        math.cos(0.2 * math.pi),
        math.sin(0.4 * math.pi),
        math.cos(0.4 * math.pi),
    ]
    assert torch.allclose(values, torch.tensor(expected), atol=1e-6)


def test_slots_close_up_only_where_fewer_suffice() -> None:
    rows = [(1, 0), (2, 0), (3, 0), (2, 1), (3, 1)]
    assert assign_slots(rows, {2, 3}) == (
        {(2, 0): 0, (3, 0): 1, (2, 1): 0, (3, 1): 1},
        2,
    )
    # Frame 1 keeps its hole: frame 0 still needs three.
    rows = [(2, 0), (3, 0), (4, 0), (1, 1), (3, 1)]
    slots, count = assign_slots(rows, {2, 3, 4})
    assert count == 3 and slots[3, 1] == 1


class Bomb:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.marker,))


@pytest.mark.parametrize("legacy", [False, True])
def test_code_in_a_checkpoint_is_not_run(log: DrivingLog, tmp_path: Path, legacy: bool) -> None:
    marker, path = tmp_path / "it-ran", tmp_path / "a.pth"
    content = checkpoint(extra=Bomb(marker))
    if legacy:
        path.write_bytes(pickle.dumps({"background": Bomb(marker)}, 2))
    else:
        save(path, content)
    with pytest.raises(InputError, match="never unpickled") as error:
        import_street_gaussians(path, log, tmp_path / "scene")
    assert "\n" not in str(error.value)
    assert not marker.exists() and not (tmp_path / "scene").exists()


def broken(part: str, key: str, value: Any) -> dict[str, Any]:
    content = checkpoint()
    if value is None:
        del content[part][key]
    else:
        content[part][key] = value
    return content


NAN = torch.zeros(300, 3)
NAN[7, 1] = math.nan


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (checkpoint(background=None), "background: is missing"),
        (checkpoint(background=torch.zeros(3)), "background: is Parameter|background: is Tensor"),
        (broken("background", "opacity", None), r"background\.opacity: is missing"),
        (broken("background", "xyz", torch.zeros(300, 4)), r"background\.xyz: has shape"),
        (broken("background", "scaling", NAN), r"background\.scaling: is not finite at \[7, 1\]"),
        (broken("background", "rotation", torch.zeros(300, 4)), r"background\.rotation: row 0"),
        (broken("background", "rotation", torch.full((300, 4), 1e-30)), r"rotation: row 0 has a"),
        (broken("background", "scaling", torch.full((300, 3), 20.0)), r"scaling: row 0 is out of"),
        (broken("background", "opacity", torch.full((300, 1), 1e30)), r"opacity: row 0 is out of"),
        (broken("background", "feature_dc", torch.full((300, 1, 3), 1e37)), "feature_rest: row 0"),
        (checkpoint(iter=10**400), "iter: is not a number of steps"),
        (broken("background", "feature_rest", torch.zeros(300, 5, 3)), r"feature_rest: has 5"),
        (broken("background", "xyz", "text"), r"background\.xyz: is str"),
        (broken("background", "xyz", torch.zeros(300, 3).to_sparse()), "sparse_coo tensor"),
        (broken("obj_003", "feature_dc", torch.zeros(80, 3)), r"obj_003\.feature_dc: has shape"),
        (checkpoint(sky_cubemap={"params": {"sky_cube_map": torch.zeros(6, 4, 5, 3)}}), "squares"),
        (
            checkpoint(obj_004=made.street_gaussians_part(made.make_car(1))),
            "actor obj_004: is not a track of log drive",
        ),
        (
            checkpoint(actor_pose={"params": {"opt_trans": torch.zeros(4, 2, 3)}}),
            r"opt_trans: is for \[4, 2\] frames and slots",
        ),
        ([1, 2], "holds list, not a table"),
    ],
)
def test_broken_checkpoints_are_refused_by_key(
    log: DrivingLog, processed: Path, tmp_path: Path, content: Any, line: str
) -> None:
    path = save(tmp_path / "a.pth", content)
    with pytest.raises(InputError, match=line):
        import_street_gaussians(path, log, tmp_path / "scene", processed=processed)
    assert not (tmp_path / "scene").exists()


def test_a_cut_file_and_a_missing_one(log: DrivingLog, tmp_path: Path) -> None:
    path = save(tmp_path / "a.pth", checkpoint())
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="is damaged"):
        import_street_gaussians(path, log, tmp_path / "scene")
    with pytest.raises(InputError, match="is missing"):
        import_street_gaussians(tmp_path / "b.pth", log, tmp_path / "scene")


@pytest.mark.parametrize(
    ("member", "text", "line"),
    [
        ("track/track_info.txt", "header\n0 3 vehicle\n", "line 2: has 3 columns"),
        (
            "track/track_info.txt",
            "header\n0 b vehicle 0 1 1 1 5 0 0 0\n",
            "track: 'b' is not a number",
        ),
        ("track/track_camera_vis.json", "[1]", "not a table of cameras"),
        ("track/track_ids.json", "[1]", "not an object of track numbers"),
        ("timestamps.json", "{}", "FRAME: lacks a time"),
        ("timestamps.json", json.dumps({n: dict.fromkeys(STAMPS, 7) for n in NAMES}), "increase"),
        ("ego_pose/000004.txt", "1 2 3", "16 finite numbers are needed"),
    ],
)
def test_broken_processed_folders_are_refused(
    log: DrivingLog, processed: Path, tmp_path: Path, member: str, text: str, line: str
) -> None:
    (processed / member).write_text(text)
    path = save(tmp_path / "a.pth", checkpoint())
    with pytest.raises(InputError, match=line):
        import_street_gaussians(path, log, tmp_path / "scene", processed=processed)


@pytest.mark.parametrize("frames", [(3, 2), (0, 11), (-1, 4)])
def test_frames_that_the_folder_does_not_have(
    log: DrivingLog, processed: Path, tmp_path: Path, frames: tuple[int, int]
) -> None:
    path = save(tmp_path / "a.pth", checkpoint())
    with pytest.raises(InputError, match="not all of them are in ego_pose"):
        import_street_gaussians(path, log, tmp_path / "s", processed=processed, frames=frames)
