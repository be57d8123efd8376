from __future__ import annotations

import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import DrivingLog, read_log
from recast.scene import load_scene, render_scene
from recast_bridges.scenes import import_mtgs, import_mtgs_with_log
from support import trained_scenes as made
from support.mtgs_scenes import (
    NAME,
    RECON_FROM_OFFSET,
    THERE,
    checkpoint,
    fourier,
    frames,
    published,
    save,
    save_whole,
)


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return made.make_log()


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_the_import_draws_what_the_published_renderer_draws(
    log: DrivingLog, tmp_path: Path, share: float
) -> None:
    path = save(tmp_path, checkpoint(), frames())
    record = import_mtgs(path, log, tmp_path / "scene", share=share)
    scene = load_scene(tmp_path / "scene")
    assert record.tracks == {made.CAR: made.CAR, made.PARKED: made.PARKED}
    assert set(scene.actors) == {made.CAR, made.PARKED}
    assert list(scene.actors[made.CAR].trajectory.timestamps_us) == [made.TIMES[i] for i in THERE]
    frame = THERE[0] + share * (THERE[-1] - THERE[0])
    time = int(made.TIMES[int(frame)])
    camera = made.camera_from_world(frame)
    with_car = render_scene(scene, made.CAMERA, camera, scene.actor_poses(time)).rgb
    without = render_scene(scene, made.CAMERA, camera, {}).rgb
    # float32: pixels of 200 m far balls move by 1e-4, harmonics are turned; 1e-4 in all.
    assert np.abs(with_car - published(frame, share, True)).max() < 5e-4
    assert np.abs(without - published(frame, share, False)).max() < 5e-4
    assert np.abs(with_car - without).max() > 0.1
    assert np.abs(with_car - published(frame, 1.0 - share / 2, True)).max() > 0.02
    dark = [n for n, one in enumerate(record.left_out) if one.startswith("sky")]
    assert not dark and scene.sky.colours.max() == 0


def test_absent_frames_and_what_is_not_carried_over_are_told(
    log: DrivingLog, tmp_path: Path
) -> None:
    content = checkpoint()
    car = content[f"na_rigid_{made.CAR}"]["state_dict"]
    car["instance_valid"] = torch.ones(made.FRAMES)
    car["instance_valid"][5] = 0  # one more absent frame, in the middle
    record = import_mtgs(save(tmp_path, content), log, tmp_path / "scene", leave_out=("walker",))
    scene = load_scene(tmp_path / "scene")
    times = [made.TIMES[i] for i in THERE if i != 5]
    assert list(scene.actors[made.CAR].trajectory.timestamps_us) == times
    assert made.CAR not in scene.actor_poses(int(made.TIMES[0]))
    assert made.CAR in scene.actor_poses(int(made.TIMES[5]))
    assert (
        f"{made.CAR}: absent for a while in the scene; interpolated in the import" in record.changed
    )
    assert "walker: left out as requested" in record.left_out
    assert any(line.startswith("1 actors of other drives") for line in record.left_out)
    again = import_mtgs(tmp_path / NAME / "background" / f"{NAME}.ckpt", log, tmp_path / "b")
    assert any(line.startswith("na_deform_walker: a Deformable") for line in again.left_out)


def test_the_gaussians_may_be_a_table_of_their_own(log: DrivingLog, tmp_path: Path) -> None:
    content = checkpoint()
    for node in content.values():
        state = node["state_dict"]
        names = [name for name in state if name.startswith("gauss_params.")]
        state["gauss_params"] = {name.split(".")[1]: state.pop(name) for name in names}
    import_mtgs(save(tmp_path / "a", content), log, tmp_path / "nested")
    import_mtgs(save(tmp_path / "b", checkpoint()), log, tmp_path / "flat")
    nested, flat = load_scene(tmp_path / "nested"), load_scene(tmp_path / "flat")
    assert torch.equal(nested.background.sh, flat.background.sh)
    assert torch.equal(nested.actors[made.CAR].gaussians.sh, flat.actors[made.CAR].gaussians.sh)


def test_colours_that_change_with_the_angle_are_averaged(log: DrivingLog, tmp_path: Path) -> None:
    content = checkpoint()
    content[f"na_rigid_{made.CAR}"]["config"]["fourier_in_space"] = "spatial"
    import_mtgs(save(tmp_path, content), log, tmp_path / "scene")
    own = load_scene(tmp_path / "scene").actors[made.CAR].gaussians
    # cos and sin of whole multiples of the angle average to nothing, the first term is 1.
    assert torch.allclose(own.sh[:, 0], fourier()[:, 0], rtol=0, atol=1e-6)


def test_actors_are_told_by_token_by_name_and_by_place(log: DrivingLog, tmp_path: Path) -> None:
    content = checkpoint()
    content["na_rigid_moved"] = content.pop(f"na_rigid_{made.CAR}")
    content["na_mirrored_still"] = content.pop(f"na_mirrored_{made.PARKED}")
    path, names = save(tmp_path, content), tmp_path / "tracks.json"
    record = import_mtgs(path, log, tmp_path / "by-place")
    assert record.tracks == {"moved": made.CAR, "still": made.PARKED}
    names.write_text(json.dumps({"moved": made.PARKED}))
    record = import_mtgs(path, log, tmp_path / "by-name", tracks=names)
    assert record.tracks == {"moved": made.PARKED}
    scene = load_scene(tmp_path / "by-name")
    assert set(scene.actors) == {made.PARKED, "still"} and "still" in scene.standing
    far = scene.actors["still"].gaussians.means.abs()
    assert np.all(far.numpy().max(axis=0) * 2 >= scene.actors["still"].size)
    assert np.allclose(scene.actors["still"].size, [3.9, 1.6, 1.4], atol=0.2)
    assert any(line.startswith("still: not tracks of the log") for line in record.changed)
    for bad in ({"ghost": made.CAR}, {"moved": "ghost"}):
        names.write_text(json.dumps(bad))
        with pytest.raises(InputError, match="ghost"):
            import_mtgs(path, log, tmp_path / "bad", tracks=names)


def test_the_recorded_frames_are_compared_with_the_log(log: DrivingLog, tmp_path: Path) -> None:
    fine = import_mtgs(save(tmp_path / "a", checkpoint(), frames()), log, tmp_path / "fine")
    assert "0.00 m from the log's (median of 11 frames)" in fine.placed_by and not fine.warnings
    far = import_mtgs(save(tmp_path / "b", checkpoint(), frames(2.5)), log, tmp_path / "far")
    assert far.warnings == ["the ego of the scene is 2.50 m from the log's"]
    other = save(tmp_path / "c", checkpoint(), frames(later_us=10**9))
    with pytest.raises(InputError, match="no frame is in log drive"):
        import_mtgs(other, log, tmp_path / "other")
    assert np.allclose(np.array(fine.world_from_scene)[:3, 3], RECON_FROM_OFFSET, rtol=0, atol=1e-9)


def test_a_log_is_made_of_the_files_of_the_street(log: DrivingLog, tmp_path: Path) -> None:
    path = save_whole(tmp_path / "a")
    record = import_mtgs_with_log(path, tmp_path / "log", tmp_path / "own")
    assert "0.00 m from the log's" in record.placed_by and not record.warnings
    own = read_log(tmp_path / "log")
    assert set(own.tracks) == {made.CAR, made.PARKED}
    assert [own.tracks[name].category for name in (made.CAR, made.PARKED)] == ["car", "cyclist"]
    assert np.allclose(own.tracks[made.CAR].size, [3.9, 1.6, 1.4], rtol=0, atol=0.2)
    camera = own.cameras["CAM_F0"]
    assert np.allclose(camera.camera.matrix, made.CAMERA.matrix)
    assert camera.camera.distortion == (0.1, 0, 0, 0, 0)
    assert np.allclose(camera.rig_from_camera, made.RIG_FROM_CAMERA, rtol=0, atol=1e-9)
    # The same street in both worlds: their offsets tell how they lie to each other.
    import_mtgs(path, log, tmp_path / "scene")
    scene, other = load_scene(tmp_path / "own"), load_scene(tmp_path / "scene")
    shift = scene.world_offset - other.world_offset
    moved = scene.background.means + torch.from_numpy(shift).float()
    assert torch.allclose(moved, other.background.means, rtol=0, atol=1e-3)  # 200 m in float32
    time = int(made.TIMES[5])
    true = made.world_from_car(5)[:3, 3]
    for poses in (
        scene.actor_poses(time),
        {k: t.trajectory.at(time) for k, t in own.tracks.items()},
    ):
        assert np.allclose(poses[made.CAR][:3, 3] + shift, true, rtol=0, atol=1e-4)
    assert np.allclose(own.world_from_rig.poses[:, :3, 3] + shift, _ego_places(), atol=1e-6)


def _ego_places() -> np.ndarray:
    return np.stack([made.world_from_rig(frame)[:3, 3] for frame in range(made.FRAMES)])


@pytest.mark.parametrize(
    ("camera", "line"),
    [
        ({"sensor2ego_rotation": np.zeros(4)}, "sensor2ego_rotation: is neither a quaternion"),
        ({"sensor2ego_translation": np.zeros(2)}, "sensor2ego_translation: is not three metres"),
        ({"colmap_param": {}}, r"cams\.CAM_F0\.colmap_param\.cam_intrinsic: is missing"),
        ({"width": 0}, "width: or height: 0 x 40 pixels"),
        ({"width": "wide"}, "width: is str, not a number"),
    ],
)
def test_a_log_of_broken_files_is_not_written(
    tmp_path: Path, camera: dict[str, Any], line: str
) -> None:
    path = save_whole(tmp_path / "a", **camera)
    with pytest.raises(InputError, match=line):
        import_mtgs_with_log(path, tmp_path / "log", tmp_path / "scene")
    with pytest.raises(InputError, match="ghost"):  # after the log was written
        import_mtgs_with_log(
            save_whole(tmp_path / "b"), tmp_path / "log", tmp_path / "scene", leave_out=("ghost",)
        )
    assert not (tmp_path / "log").exists() and not (tmp_path / "scene").exists()


class Hostile:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_code_in_the_checkpoint_or_beside_it_is_not_run(log: DrivingLog, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    content = checkpoint()
    content["background"]["config"]["extra"] = Hostile(ran)
    path = save(tmp_path / "a", content)
    with pytest.raises(InputError, match=r"mkdir, which is not a tensor and is never unpickled"):
        import_mtgs(path, log, tmp_path / "scene")
    pickled = frames()
    pickled["2021-0"]["frame_infos"][3]["extra"] = Hostile(ran)
    path = save(tmp_path / "b", checkpoint(), pickled)
    with pytest.raises(InputError, match=r"mkdir, which is never unpickled; name the checkpoint"):
        import_mtgs(path, log, tmp_path / "scene")
    assert not ran.exists() and not (tmp_path / "scene").exists()


def test_the_command_takes_a_log_or_writes_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["scene", "import", "mtgs", str(save_whole(tmp_path)), "--out", str(tmp_path / "scene")]
    assert main(words) == 2
    assert capsys.readouterr().err.splitlines() == [
        "recast: command line: --log or --own-log: exactly one of the two is needed; "
        "give one of them"
    ]
    assert main([*words, "--own-log", str(tmp_path / "log")]) == 0
    assert f"wrote {tmp_path / 'scene'}" in capsys.readouterr().out.replace("\n", "")
    assert main([*words[:-1], str(tmp_path / "b"), "--log", str(tmp_path / "log")]) == 0
    again, first = load_scene(tmp_path / "b"), load_scene(tmp_path / "scene")
    assert torch.equal(again.background.means, first.background.means)
    (tmp_path / NAME / "video_scene_dict.pkl").write_bytes(pickle.dumps(Hostile(tmp_path / "ran")))
    capsys.readouterr()
    assert main([*words[:-1], str(tmp_path / "c"), "--log", str(tmp_path / "log")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "c").exists() and not (tmp_path / "ran").exists()


def broken(node: str, place: str, key: str, value: Any) -> dict[str, Any]:
    content = checkpoint()
    own = content[node][place]
    own.pop(key, None)
    if value is not None:
        own[key] = value
    return content


CAR_NODE = f"na_rigid_{made.CAR}"


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (checkpoint(background=None), "background: is missing"),
        (broken("background", "config", "type", None), r"background\.config\.type: is missing"),
        (broken("background", "config", "type", "X"), "background: is missing"),
        (
            broken("background", "config", "type", "RigidSubModel"),
            "background: is missing, no scenery",
        ),
        (broken("background", "config", "sh_degree", None), "sh_degree: is missing"),
        (broken("background", "config", "sh_degree", 4), r"sh_degree: is 4, expected 0 to 3"),
        (broken("background", "config", "scale_dim", 2), r"scale_dim: is 2, expected 1 or 3"),
        (
            broken("background", "config", "recon2world_translation", np.array([1.0, np.nan, 0])),
            "recon2world_translation: is not three metres",
        ),
        (
            broken("background", "state_dict", "gauss_params.means", None),
            r"background\.state_dict\.gauss_params\.means: is missing",
        ),
        (
            broken("background", "state_dict", "gauss_params.features_rest", torch.ones(300, 3, 3)),
            "has 3 harmonics, degree 3 needs 15",
        ),
        (
            broken(CAR_NODE, "state_dict", "gauss_params.features_dc", torch.ones(80, 4, 3)),
            r"features_dc: has shape \[80, 4, 3\], expected \[80, 5, 3\]",
        ),
        (broken(CAR_NODE, "config", "fourier_features_dim", 2.5), "fourier_features_dim: is 2.5"),
        (broken(CAR_NODE, "config", "log_timestamps", None), "log_timestamps: is missing"),
        (
            broken(CAR_NODE, "config", "log_timestamps", torch.arange(3)),
            "log_timestamps: has 3 times for 11 poses",
        ),
        (
            broken(
                CAR_NODE,
                "config",
                "log_timestamps",
                torch.from_numpy(made.TIMES + 1_600 * 10**12).float(),
            ),
            "log_timestamps: are not microseconds that increase",
        ),
        (
            broken(CAR_NODE, "config", "log_timestamps", torch.from_numpy(made.TIMES + 10**9)),
            "log_timestamps: lie outside of log drive for all actors",
        ),
        (
            broken(CAR_NODE, "state_dict", "instance_quats", torch.zeros(11, 4)),
            "instance_quats: holds a quaternion of norm zero",
        ),
        (
            broken(CAR_NODE, "state_dict", "instance_trans", torch.full((11, 3), -torch.inf)),
            "instance_trans: is not finite",
        ),
        (
            broken(CAR_NODE, "state_dict", "instance_trans", torch.ones(11, 2)),
            "instance_trans: has",
        ),
    ],
)
def test_broken_checkpoints_are_refused_by_key(
    log: DrivingLog, tmp_path: Path, content: Any, line: str
) -> None:
    with pytest.raises(InputError, match=line):
        import_mtgs(save(tmp_path, content), log, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def test_a_folder_without_one_checkpoint_is_refused(log: DrivingLog, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has 0 files background/\*\.ckpt"):
        import_mtgs(tmp_path, log, tmp_path / "scene")


@pytest.mark.parametrize(
    ("pickled", "line"),
    [
        ([1, 2], "holds list, not a table"),
        ({"a": {"frame_infos": 3}}, "drive a: has no list frame_infos"),
        ({"a": {"frame_infos": [3]}}, r"a\.frame_infos\[0\]: is not a table"),
        ({"a": {"frame_infos": [{}]}}, r"a\.frame_infos\[0\]\.timestamp: is missing"),
        ({"a": {"frame_infos": [{"timestamp": -1}]}}, "timestamp: is -1, not microseconds"),
        (
            {"a": {"frame_infos": [{"timestamp": 1, "ego2global": np.full((4, 4), np.nan)}]}},
            "ego2global: is not a pose in metres",
        ),
    ],
)
def test_broken_frames_are_refused(
    log: DrivingLog, tmp_path: Path, pickled: Any, line: str
) -> None:
    with pytest.raises(InputError, match=line):
        import_mtgs(save(tmp_path, checkpoint(), pickled), log, tmp_path / "scene")
