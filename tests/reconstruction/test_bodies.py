from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from recast.core.errors import InputError
from recast.logs import DrivingLog, Track, Trajectory
from recast.reconstruction import SceneConfig, train_scene
from recast.reconstruction.bodies import read_bodies
from recast.reconstruction.densify import plan_change
from recast.scene import load_scene
from recast.scene.deformation import Skinning
from recast.scene.store import BODIES_FILE, read_tensors, write_tensors
from recast.splats.gaussians import quat_multiply, quat_to_matrix
from support.gaussian_clouds import part
from support.tiny_street import TINY, walking

VERTICES, JOINTS, SHAPES = 40, 4, 3
PARENTS = np.array([-1, 0, 1, 1])
Members = dict[str, np.ndarray]


def body_model(seed: int = 0) -> Members:
    """A made-up skeleton of four joints in a cloud of vertices, about as large as a car."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(JOINTS) * 0.5, VERTICES)
    return {
        "v_template": rng.normal(size=(VERTICES, 3)) * [1.0, 0.5, 0.4],
        "shapedirs": 0.05 * rng.normal(size=(VERTICES, 3, SHAPES)),
        "J_regressor": rng.dirichlet(np.ones(VERTICES), JOINTS),
        "weights": weights,
        "kintree_table": np.stack([PARENTS.astype(np.uint32), np.arange(JOINTS, dtype=np.uint32)]),
    }


def body_poses(track: Track, seed: int = 1) -> Members:
    rng = np.random.default_rng(seed)
    times = track.trajectory.timestamps_us
    count = len(times)
    return {
        f"{track.track_id}/timestamps_us": times,
        f"{track.track_id}/betas": rng.normal(size=SHAPES - 1),
        f"{track.track_id}/global_orient": rng.normal(size=(count, 3)),
        f"{track.track_id}/body_pose": 0.5 * rng.normal(size=(count, JOINTS - 1, 3)),
        f"{track.track_id}/transl": track.trajectory.poses[:, :3, 3],
    }


def walk(count: int = 5) -> Track:
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        poses[k, :3, :3] = Rotation.from_euler("z", 0.3 * k).as_matrix()
        poses[k, :3, 3] = [10 + 0.4 * k, 3.0, 0.9]
    times = 1_000_000 + 100_000 * np.arange(count, dtype=np.int64)
    return Track("7", "pedestrian", np.array([0.8, 0.7, 1.8]), Trajectory(times, poses))


def config_of(folder: Path, model: Members, poses: Members) -> SceneConfig:
    np.savez(folder / "model.npz", **model)
    np.savez(folder / "poses.npz", **poses)
    names = {"smpl_model": str(folder / "model.npz"), "smpl_poses": str(folder / "poses.npz")}
    return TINY.model_copy(update={**names, "iterations": 25, "evaluate_every": 25})


def plainly_skinned(model: Members, poses: Members, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """SMPL's formulas vertex by vertex: rest vertices, and vertices in the world."""
    betas = poses["7/betas"]
    rest = np.array(model["v_template"])
    for k, beta in enumerate(betas):
        rest = rest + beta * model["shapedirs"][:, :, k]
    joints = np.array([sum(w * v for w, v in zip(row, rest)) for row in model["J_regressor"]])  # noqa: B905
    vectors = [poses["7/global_orient"][frame], *poses["7/body_pose"][frame]]
    worlds: list[np.ndarray] = []
    for j in range(JOINTS):
        own = np.eye(4)
        own[:3, :3] = Rotation.from_rotvec(vectors[j]).as_matrix()
        parent = PARENTS[j]
        own[:3, 3] = joints[j] - (joints[parent] if parent >= 0 else 0)
        worlds.append(own if parent < 0 else worlds[parent] @ own)
    moved = np.zeros_like(rest)
    for v, vertex in enumerate(rest):
        for j in range(JOINTS):
            from_joint = np.append(vertex - joints[j], 1.0)
            moved[v] += model["weights"][v, j] * (worlds[j] @ from_joint)[:3]
    return rest, moved + poses["7/transl"][frame]


def test_skinning_puts_a_body_where_smpl_puts_it_in_the_world(tmp_path: Path) -> None:
    track, model = walk(), body_model()
    poses = body_poses(track)
    body = read_bodies(config_of(tmp_path, model, poses), {"7": track})["7"]
    body.skinning.validate("7", VERTICES)
    for frame in (0, 2, 4):
        rest, expected = plainly_skinned(model, poses, frame)
        order = [int(np.abs(rest - vertex).sum(axis=1).argmin()) for vertex in body.vertices]
        assert sorted(order) == list(range(VERTICES))
        at_rest = replace(part(VERTICES, 0), means=torch.from_numpy(body.vertices).float())
        time = int(track.trajectory.timestamps_us[frame])
        local = body.skinning.at(at_rest, track.trajectory, time).means.double().numpy()
        pose = track.trajectory.poses[frame]
        world = local @ pose[:3, :3].T + pose[:3, 3]
        # float32 rest places and weights, of a few metres.
        np.testing.assert_allclose(world, expected[order], atol=1e-5)


def test_orientations_turn_with_their_joint() -> None:
    turns = Rotation.random(JOINTS, rng=3).as_quat(scalar_first=True)
    skinning = Skinning(
        torch.eye(JOINTS),
        np.zeros((JOINTS, 3)),
        PARENTS,
        np.array([5, 9]),
        np.stack([turns, turns]),
        np.zeros((2, 3)),
    )
    gaussians = part(JOINTS, 4)
    moved = skinning.at(gaussians, walk().trajectory, 7)
    chain = [Rotation.from_quat(turns[0], scalar_first=True)]
    for j in range(1, JOINTS):
        chain.append(chain[PARENTS[j]] * Rotation.from_quat(turns[j], scalar_first=True))
    for j in range(JOINTS):
        before, after = (
            quat_to_matrix(torch.nn.functional.normalize(one.quats[j], dim=0)).double().numpy()
            for one in (gaussians, moved)
        )
        np.testing.assert_allclose(after, chain[j].as_matrix() @ before, atol=1e-5)


def test_a_product_of_quaternions_is_a_product_of_rotations() -> None:
    first, second = (Rotation.random(9, rng=seed) for seed in (1, 2))
    pair = [torch.from_numpy(one.as_quat(scalar_first=True)) for one in (first, second)]
    expected = torch.from_numpy((first * second).as_matrix())
    torch.testing.assert_close(quat_to_matrix(quat_multiply(*pair)), expected)


def test_between_two_poses_a_body_is_between_them() -> None:
    turn = Rotation.from_rotvec([[0, 0, 0], [0, 0, 1.0]]).as_quat(scalar_first=True)[:, None]
    skinning = Skinning(
        torch.ones(1, 1),
        np.zeros((1, 3)),
        np.array([-1]),
        np.array([0, 100]),
        turn,
        np.array([[0.0, 0, 0], [2.0, 0, 0]]),
    )
    one = replace(part(1, 0), means=torch.tensor([[1.0, 0.0, 0.0]]))
    for time, angle in ((-50, 0.0), (25, 0.25), (100, 1.0), (300, 1.0)):
        place = skinning.at(one, walk().trajectory, time).means[0].tolist()
        assert place == pytest.approx([np.cos(angle) + 2 * angle, np.sin(angle), 0.0], abs=1e-6)


def test_rows_of_bodies_are_neither_added_nor_taken_away() -> None:
    gaussians = replace(part(6, 0), logit_opacities=torch.full((6,), -9.0))
    settled = torch.tensor([True, True, True, False, False, False])
    change = plan_change(
        gaussians,
        torch.ones(6),
        threshold=0.1,
        most_new=6,
        split_above=1e9,
        min_opacity=0.5,
        generator=torch.Generator(),
        settled=settled,
    )
    assert change.kept.tolist() == [0, 1, 2] and len(change.born) == 0


def test_a_body_is_trained_saved_and_read_back(tiny_log: DrivingLog, tmp_path: Path) -> None:
    log = walking(tiny_log)
    config = config_of(tmp_path, body_model(), body_poses(log.tracks["0"]))
    result = train_scene(log, tmp_path / "scene", config)
    actor = result.scene.actors["0"]
    assert isinstance(actor.deformation, Skinning) and len(actor.gaussians) == VERTICES
    times = [int(time) for time in actor.trajectory.timestamps_us[[0, -1]]]
    assert not torch.equal(
        actor.shaped_at(times[0]).gaussians.means, actor.shaped_at(times[1]).gaussians.means
    )
    loaded = load_scene(tmp_path / "scene").actors["0"].deformation
    assert isinstance(loaded, Skinning)
    for name in ("joints", "parents", "timestamps_us", "rotations", "translations", "weights"):
        before, after = (np.asarray(getattr(s, name)) for s in (actor.deformation, loaded))
        assert before.dtype == after.dtype and np.array_equal(before, after)
    _damage_and_read(tmp_path / "scene")


def _damage_and_read(folder: Path) -> None:
    path = folder / BODIES_FILE
    tensors, header = read_tensors(path)
    tensors = {name: tensor.clone() for name, tensor in tensors.items()}
    damages: list[tuple[Members, dict[str, object], str]] = [
        ({"weights/0": tensors["weights/0"][:, :3]}, {}, "weights: expected"),
        ({"weights/0": 2 * tensors["weights/0"]}, {}, "weights"),
        ({"parents/0": torch.tensor([-1, 2, 1, 1])}, {}, "an earlier one"),
        ({"rotations/0": 3 * tensors["rotations/0"]}, {}, "not of length 1"),
        ({"joints/0": tensors["joints/0"].float()}, {}, "is of torch.float32"),
        ({"more/0": tensors["joints/0"]}, {}, "not expected"),
        ({}, {"version": 2}, "this recast reads 1"),
        ({}, {"actors": ["9"]}, "joints/0"),
    ]
    for changed, notes, message in damages:
        write_tensors(path, {**tensors, **changed}, {**header, **notes})  # type: ignore[dict-item]
        with pytest.raises(InputError, match=message) as caught:
            load_scene(folder)
        assert "\n" not in str(caught.value)


def _set(name: str, value: object) -> Callable[[Members], None]:
    return lambda members: members.update({name: np.asarray(value)})


@pytest.mark.parametrize(
    ("which", "damage", "message"),
    [
        ("model", lambda m: m.pop("weights"), "weights: is missing"),
        ("model", _set("weights", np.ones((VERTICES, JOINTS))), "does not add up|not within"),
        ("model", _set("weights", np.ones((3, JOINTS)) / JOINTS), "weights: expected"),
        ("model", _set("v_template", np.full((VERTICES, 3), np.nan)), "not finite"),
        ("model", _set("parents", [-1, 3, 0, 0]), "an earlier one"),
        ("model", _set("v_template", np.array([{}, None])), "pickled Python objects"),
        ("model", _set("v_template", np.ones((VERTICES, 3), bool)), "not numbers"),
        ("poses", lambda m: m.pop("7/betas"), "betas is missing"),
        ("poses", _set("7/betas", np.zeros(SHAPES + 1)), "betas: at most 3"),
        ("poses", _set("7/body_pose", np.zeros((5, 2, 3))), r"expected \(5, 3, 3\)"),
        ("poses", _set("7/transl", np.full((5, 3), np.inf)), "not finite"),
        ("poses", _set("7/timestamps_us", np.arange(5.0)), "whole numbers"),
        ("poses", _set("7/timestamps_us", np.array([5, 4, 3, 2, 1])), "timestamps_us"),
        ("poses", _set("8/betas", np.zeros(2)), "track '8': is not an actor"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(
    tmp_path: Path, which: str, damage: Callable[[Members], None], message: str
) -> None:
    track, model = walk(), body_model()
    poses = body_poses(track)
    damage({"model": model, "poses": poses}[which])
    with pytest.raises(InputError, match=message) as caught:
        read_bodies(config_of(tmp_path, model, poses), {"7": track})
    assert "\n" not in str(caught.value)


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    track, model = walk(), body_model()
    config = config_of(tmp_path, model, body_poses(track))
    assert read_bodies(TINY, {"7": track}) == {}
    with pytest.raises(InputError, match="smpl_poses: is not named"):
        read_bodies(config.model_copy(update={"smpl_poses": ""}), {})
    with pytest.raises(InputError, match="is missing"):
        read_bodies(config.model_copy(update={"smpl_model": str(tmp_path / "no.npz")}), {})
    for content in (b"", b"PK\x03\x04 nothing", (tmp_path / "model.npz").read_bytes()[:900]):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(InputError, match=r"cannot be read|damaged|missing|bytes"):
            read_bodies(config.model_copy(update={"smpl_model": str(tmp_path / "bad.npz")}), {})
