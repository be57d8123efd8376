"""A person on a user's skeleton walks as its poses do, also on another way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from actors.people import made_up_people as made_up
from actors.people import made_up_skeleton as skeletons
from recast.actors import Actor, Asset, register
from recast.actors.evidence import Evidence, FreeSpace, Sighting
from recast.actors.generate import PEOPLE_GENERATOR, VEHICLE
from recast.actors.observe import observation_of_view
from recast.actors.people import clothes, generator
from recast.actors.people.body import Region, surface_of
from recast.actors.people.fit import PersonFit
from recast.actors.people.skeleton import SkeletonBody, skeleton_body
from recast.actors.people.views import gait_of, gaussians_of
from recast.actors.refine.refine import refine
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.reconstruction import SceneConfig
from recast.reconstruction.bodies import read_bodies
from recast.reconstruction.config import write_config
from recast.reconstruction.train import CONFIG_FILE
from recast.scene import SceneActor, SkyMap, StreetScene, load_scene, save_scene
from recast.scene.actor import draw, look_at
from recast.scene.deformation import Skinning
from recast.splats import MIP, Gaussians, morton_order
from recast.splats.gaussians import C0

PHASE = 0.3


def walk(metres: float, count: int, turn: float = 0.0) -> Trajectory:
    """Straight on along x; `turn` radians by which the label looks aside."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = se3.rotation_z(turn)
    poses[:, 0, 3], poses[:, 2, 3] = np.linspace(0, metres, count), made_up.BOX[2] / 2
    return Trajectory(np.arange(count, dtype=np.int64) * 100_000, poses)


def way(trajectory: Trajectory) -> np.ndarray:
    return np.asarray(trajectory.poses[[0, -1], :2, 3])


def body_of(actor: SceneActor, line: np.ndarray) -> SkeletonBody:
    """The body of a street that was not trained: its Gaussians are the vertices."""
    return skeleton_body(actor, actor.gaussians.means.double().numpy(), line)


def errors(body: SkeletonBody, actor: SceneActor) -> np.ndarray:
    """(T, N) metres from the points of the gait to the skin's own, at the logged times."""
    line, surface = way(actor.trajectory), body.surface
    gait = gait_of(surface, np.eye(4), body.cycle, body.phase, line)
    gaussians = gaussians_of(surface, np.eye(4), np.full((len(surface.points), 3), 0.5))
    gait.validate("gait", len(gaussians))
    assert isinstance(actor.deformation, Skinning)
    found = []
    for time, pose in zip(actor.trajectory.timestamps_us, actor.trajectory.poses, strict=True):
        own = actor.deformation.at(actor.gaussians, actor.trajectory, int(time)).means
        found.append((gait.at(gaussians, pose).means - own).norm(dim=1).numpy())
    return np.array(found)


def person(trajectory: Trajectory, cycle: float = 1.25, noise: float = 0.0) -> SceneActor:
    gone = trajectory.poses[:, 0, 3]
    shape = replace(made_up.WALKER, cycle=cycle)
    return skeletons.walker(shape, made_up.BOX, trajectory, gone, PHASE, noise=noise)


def looks_aside(actor: SceneActor, turned: Trajectory, angle: float) -> SceneActor:
    """The same motion in a box that is turned by `angle` radians."""
    skin, back = actor.deformation, se3.rotation_z(-angle)
    assert isinstance(skin, Skinning)
    turns = np.array(skin.rotations)
    turns[:, 0] = se3.matrix_to_quat(back @ se3.quat_to_matrix(turns[:, 0]))
    shifts = (skin.joints[0] + skin.translations) @ back.T - skin.joints[0]
    seen = replace(skin, rotations=turns, translations=shifts)
    return replace(actor, trajectory=turned, deformation=seen)


@settings(max_examples=8, deadline=None)
@given(cycle=st.floats(0.9, 2.2), cycles=st.floats(0.55, 12.0))
def test_the_gait_is_where_the_poses_are(cycle: float, cycles: float) -> None:
    trajectory = walk(cycles * cycle, int(cycles * 13) + 2)
    actor = person(trajectory, cycle)
    body = body_of(actor, way(trajectory))
    wrong = errors(body, actor)
    assert wrong.mean() < 0.013
    assert np.quantile(wrong, 0.99) < 0.045
    # A whole cycle tells its length; half a cycle with few poses leaves some to habit.
    assert body.cycle == pytest.approx(cycle, rel=0.02 if cycles > 2 else 0.1)
    assert body.explained > 0.9


def test_one_step_tells_the_other() -> None:
    """The poses are those of one step; the second step of the truth is the first one mirrored."""
    short, whole = walk(0.65, 8), walk(2.6, 29)
    body = body_of(person(short), way(short))
    wrong = errors(body, person(whole))
    assert wrong.mean() < 0.015
    assert np.quantile(wrong, 0.99) < 0.05


def test_poses_that_jitter_are_averaged() -> None:
    trajectory = walk(6.0, 50)
    body = body_of(person(trajectory, noise=2.0), way(trajectory))
    assert body.cycle == pytest.approx(1.25, rel=0.02)
    jitter = errors(body, person(trajectory, noise=2.0)).mean()
    assert errors(body, person(trajectory)).mean() < 0.6 * jitter


def test_a_bent_arm_stays_bent() -> None:
    """What is not alike on both sides is kept, if the poses show more than a cycle."""
    trajectory = walk(5.0, 50)
    actor = person(trajectory)
    assert isinstance(actor.deformation, Skinning)
    turns = np.array(actor.deformation.rotations)
    right = 19
    turns[:, right] = se3.matrix_to_quat(
        se3.quat_to_matrix(turns[:, right]) @ se3.exp([0, 0, 0, 0, -1.2, 0])[:3, :3]
    )
    actor = replace(actor, deformation=replace(actor.deformation, rotations=turns))
    assert np.quantile(errors(body_of(actor, way(trajectory)), actor), 0.99) < 0.04


def test_a_label_that_looks_aside_and_a_wait_change_nothing() -> None:
    turned, straight = walk(5.0, 50, 0.3), walk(5.0, 50)
    actor = person(straight)
    plain = body_of(actor, way(straight))
    assert isinstance(actor.deformation, Skinning)
    aside = looks_aside(actor, turned, 0.3)
    assert np.quantile(errors(body_of(aside, way(turned)), aside), 0.99) < 0.04
    # It stands for 3 s in the middle, feet together.
    poses = np.concatenate(
        [straight.poses[:25], *30 * [straight.poses[25:26]], straight.poses[25:]]
    )
    waits = Trajectory(np.arange(80, dtype=np.int64) * 100_000, poses)
    skin = actor.deformation
    turns = np.insert(skin.rotations, 25 * np.ones(30, int), skin.rotations[25], axis=0)
    turns[26:54, 1:9] = [1.0, 0, 0, 0]
    shifts = np.insert(skin.translations, 25 * np.ones(30, int), skin.translations[25], axis=0)
    stopped = replace(skin, timestamps_us=waits.timestamps_us, rotations=turns, translations=shifts)
    found = body_of(replace(actor, trajectory=waits, deformation=stopped), way(straight))
    assert found.cycle == pytest.approx(plain.cycle, rel=0.01)
    assert found.explained > 0.9


def test_the_surface_is_that_of_the_skin() -> None:
    trajectory = walk(3.0, 30)
    body = body_of(person(trajectory), way(trajectory))
    surface, truth = body.surface, surface_of(made_up.WALKER, 0.03)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(
        surface.motions[0], np.broadcast_to(np.eye(4), (24, 4, 4)), atol=1e-9
    )
    assert np.mean(surface.region == truth.region) > 0.95
    assert set(surface.region) == {
        Region.SKIN,
        Region.HAIR,
        Region.TOP,
        Region.TROUSERS,
        Region.SHOES,
    }
    assert body.height == pytest.approx(made_up.WALKER.height, rel=0.02)
    # Patches are about 3 cm apart.
    assert np.median(surface.spacing) == pytest.approx(0.03, abs=0.006)
    # At rest the twin is the mirrored point.
    rest = skeletons.skin(made_up.WALKER)[2].points
    gap = np.linalg.norm(rest[surface.twin] * [-1, 1, 1] - rest, axis=1)
    assert np.quantile(gap, 0.99) < 0.02


def test_normals_point_outward() -> None:
    trajectory = walk(3.0, 30)
    body = body_of(person(trajectory), way(trajectory))
    truth = surface_of(made_up.WALKER, 0.03)
    motion = truth.motions[round((PHASE - body.phase) % 1.0 * len(truth.motions)) % 48]
    turns = np.einsum("nj,jab->nab", truth.weights, motion[:, :3, :3])
    agree = np.einsum("na,nab,nb->n", body.surface.normals, turns, truth.normals)
    assert np.mean(agree > 0) > 0.97
    assert np.median(agree) > 0.95


@pytest.mark.parametrize("metres", [0.1, 4.0])
def test_who_stands_has_one_pose(metres: float) -> None:
    """Somebody who hardly moves, or is carried along."""
    trajectory = walk(metres, 20)
    still = skeletons.walker(
        made_up.WALKER, made_up.BOX, trajectory, np.zeros(20), PHASE, noise=0.5
    )
    body = body_of(still, way(trajectory))
    assert len(body.surface.motions) == 1
    assert errors(body, still).mean() < 0.02


def test_one_pose_alone_stands() -> None:
    trajectory = walk(4.0, 20)
    times = trajectory.timestamps_us[7:8]
    actor = skeletons.walker(
        made_up.WALKER, made_up.BOX, trajectory, np.zeros(1), PHASE, times=times
    )
    body = body_of(actor, way(trajectory))
    assert len(body.surface.motions) == 1
    assert errors(body, actor).max() < 1e-4


def test_poses_of_half_a_step_are_refused() -> None:
    trajectory = walk(0.35, 10)
    with pytest.raises(ValueError, match="of a step, one is needed"):
        body_of(person(trajectory), way(trajectory))


def test_poses_that_do_not_repeat_are_refused() -> None:
    trajectory = walk(20.0, 150)
    rng = np.random.default_rng(1)
    gone = rng.uniform(0, 1.25, 150)
    actor = skeletons.walker(made_up.WALKER, made_up.BOX, trajectory, gone, PHASE)
    with pytest.raises(ValueError, match="do not repeat with the way"):
        body_of(actor, way(trajectory))


def test_other_skeletons_are_refused() -> None:
    trajectory = walk(3.0, 30)
    actor = person(trajectory)
    assert isinstance(actor.deformation, Skinning)
    parents = np.array(actor.deformation.parents)
    parents[16] = 12
    for wrong in (replace(actor.deformation, parents=parents), None):
        with pytest.raises(ValueError, match="not those of SMPL"):
            body_of(replace(actor, deformation=wrong), way(trajectory))


def test_more_joints_of_hands_and_face_follow_their_parents() -> None:
    """The trees of SMPL-H and SMPL-X go on differently after the 22 joints."""
    trajectory = walk(3.0, 30)
    actor = person(trajectory)
    skin = actor.deformation
    assert isinstance(skin, Skinning)
    parents = np.concatenate([skin.parents[:22], [15, 20, 23, 24, 21, 26, 27]])
    fingers = np.concatenate([[15], np.repeat([20, 21], 3)])
    joints = np.concatenate([skin.joints[:22], skin.joints[fingers]])
    weights = torch.zeros(len(actor.gaussians), 29)
    weights[:, :22] = skin.weights[:, :22]
    turns = np.tile([1.0, 0, 0, 0], (30, 29, 1))
    turns[:, :22] = skin.rotations[:, :22]
    wider = replace(skin, weights=weights, joints=joints, parents=parents, rotations=turns)
    wider.validate("wider", len(actor.gaussians))
    wide = replace(actor, deformation=wider)
    own = errors(body_of(actor, way(trajectory)), actor)
    np.testing.assert_allclose(errors(body_of(wide, way(trajectory)), wide), own, atol=1e-5)


def test_files_of_the_format_give_the_same_body(tmp_path: Path) -> None:
    straight = walk(4.0, 40)
    moved = se3.from_rotation_translation(se3.rotation_z(2.0), [30.0, -7.0, 1.0])
    trajectory = Trajectory(straight.timestamps_us, moved @ straight.poses)
    actor = person(straight)
    files = skeletons.write_files(tmp_path, replace(actor, trajectory=trajectory))
    track = Track("7", "pedestrian", made_up.BOX, trajectory)
    read = read_bodies(SceneConfig(**files), {"7": track})["7"]
    gaussians = replace(actor.gaussians, means=torch.from_numpy(read.vertices).float())
    native = SceneActor("7", gaussians, made_up.BOX, trajectory, deformation=read.skinning)
    assert errors(body_of(native, way(trajectory)), native).mean() < 0.013


CAMERA = PinholeCamera(72, 112, 330.0, 330.0, 36.0, 56.0)
WALL = 0.62


def sightings(actor: SceneActor, count: int) -> tuple[Sighting, ...]:
    """Images of a person before a plain wall, from its right and left."""
    assert isinstance(actor.deformation, Skinning)
    found = []
    for number in range(count):
        index = number * (len(actor.trajectory.poses) - 1) // (count - 1)
        time, pose = int(actor.trajectory.timestamps_us[index]), actor.trajectory.poses[index]
        turn = np.radians(-100 + 200 * number / count)
        eye = 7.0 * np.array([np.cos(turn), np.sin(turn), 0.1])
        camera_from_object = look_at(eye, np.zeros(3))
        posed = actor.deformation.at(actor.gaussians, actor.trajectory, time)
        with torch.no_grad():
            shown = draw(posed, camera_from_object, CAMERA, MIP, (WALL,) * 3)
        found.append(
            Sighting(
                camera_name="front",
                frame=number,
                timestamp_us=time,
                camera=CAMERA,
                camera_from_world=camera_from_object @ se3.inverse(pose),
                world_from_object=pose,
                image=(shown.rgb.numpy().clip(0, 1) * 255).round().astype(np.uint8),
                mask=(shown.alpha.numpy() > 0.5).astype(np.float32),
                trust=np.ones((CAMERA.height, CAMERA.width), np.float32),
                weight=1.0,
            )
        )
    return tuple(found)


def one_crop(trajectory: Trajectory, category: str, seen: Sighting) -> Actor:
    """A slim grey person of another gait, as one crop might have shown it."""
    shape = made_up.RIDER if category == "cyclist" else replace(made_up.WALKER, girth=0.8)
    gaussians, gait = made_up.body(replace(shape, cycle=1.5), made_up.BOX)
    grey: Gaussians = replace(gaussians, sh=torch.zeros_like(gaussians.sh))
    details = {"height_m": 1.7, "girth": 0.8, "pack": "no", "cycle_m": 1.5, "differs": 0.3}
    asset = Asset(grey, VEHICLE, PEOPLE_GENERATOR, 0, details, MIP, gait=gait)
    rgba = np.dstack([seen.image, (255 * seen.mask).astype(np.uint8)])
    observation = observation_of_view(
        rgba, CAMERA, seen.camera_from_object, made_up.BOX, name="7", category=category
    )
    points = np.random.default_rng(0).normal(0, [0.1, 0.15, 0.4], (60, 3)).astype(np.float32)
    quality = replace(observation.mask_quality, lidar_inside=1.0)
    track = Track("7", category, made_up.BOX, trajectory)
    log = DrivingLog("street", {}, {}, trajectory, {"7": track})
    return register(asset, replace(observation, points=points, mask_quality=quality), log, track)


def street(native: SceneActor, folder: Path) -> StreetScene:
    """A street as its training leaves it: the configuration, and Gaussians that have moved."""
    folder.mkdir()
    config = SceneConfig(**skeletons.write_files(folder, native))
    track = Track("7", "pedestrian", made_up.BOX, native.trajectory)
    body = read_bodies(config, {"7": track})["7"]
    gaussians = native.gaussians.select(morton_order(native.gaussians.means))
    np.testing.assert_allclose(gaussians.means, body.vertices, atol=1e-6)
    noise = torch.from_numpy(np.random.default_rng(2).normal(0, 0.05, body.vertices.shape))
    gaussians = replace(gaussians, means=gaussians.means + noise.float())
    below = native.gaussians.select(torch.arange(1))
    below = replace(below, means=torch.tensor([[0.0, 0.0, -50.0]]))
    own = replace(native, gaussians=gaussians, deformation=body.skinning)
    scene = StreetScene(below, {"7": own}, SkyMap.constant(torch.full((3,), WALL)))
    save_scene(scene, folder / "scene")
    write_config(config, folder / "scene" / CONFIG_FILE)
    return load_scene(folder / "scene")


def followed(scene: StreetScene, category: str = "pedestrian", images: int = 10) -> Actor:
    trajectory = scene.actors["7"].trajectory
    seen = sightings(person(trajectory), images)
    nothing = np.zeros((0, 3), np.float32)
    evidence = Evidence("7", category, made_up.BOX, seen, nothing, FreeSpace(nothing))
    return refine(one_crop(trajectory, category, seen[2]), evidence, scene)


def test_a_completed_person_is_that_of_the_files(tmp_path: Path) -> None:
    native = person(walk(4.0, 40))
    actor = followed(street(native, tmp_path / "street"))
    provenance = actor.provenance
    assert provenance.refinement is not None and provenance.refinement.kept
    assert provenance.refinement.notes == ()
    assert provenance.details["body"] == "skeleton"
    assert provenance.details["cycle_m"] == pytest.approx(1.25, rel=0.02)
    assert not {"girth", "pack", "differs"} & set(provenance.details)
    assert actor.gait is not None and actor.shares is not None
    assert len(actor.gaussians) == len(native.gaussians) == len(actor.shares)
    actor.gait.validate("gait", len(actor.gaussians))
    assert isinstance(native.deformation, Skinning)
    order = morton_order(native.gaussians.means)
    for index in (0, 13, 30):
        time, pose = native.trajectory.timestamps_us[index], native.trajectory.poses[index]
        own = native.deformation.at(native.gaussians, native.trajectory, int(time)).means[order]
        assert float((actor.at(pose).means - own).norm(dim=1).mean()) < 0.02
    region = torch.from_numpy(surface_of(made_up.WALKER, 0.03).region)[order]
    for kind in (Region.TOP, Region.TROUSERS):
        worn = actor.gaussians.sh[region == kind, 0].median(dim=0).values
        np.testing.assert_allclose(0.5 + C0 * worn, made_up.COLOURS[kind], atol=0.08)
    # On another way it walks on, as it did a cycle before.
    beyond = np.array(native.trajectory.poses[-1])
    beyond[0, 3] += 2 * actor.gait.cycle
    last = actor.at(native.trajectory.poses[-1]).means
    assert torch.allclose(actor.at(beyond).means, last, atol=1e-4)


@pytest.mark.parametrize(
    ("case", "note"),
    [
        ("cyclist", "it has no bicycle"),
        ("tree", "not those of SMPL"),
        ("gone", "poses.npz"),
        ("changed", "have changed since the street was trained"),
        ("unsaved", "not read from a folder"),
    ],
)
def test_without_a_usable_skeleton_the_body_is_ours_and_the_report_says_so(
    case: str, note: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    category = "cyclist" if case == "cyclist" else "pedestrian"
    shape = made_up.RIDER if category == "cyclist" else made_up.WALKER
    fit = PersonFit(shape, np.zeros(2), 0.0, 0.2)
    monkeypatch.setattr(generator, "fit_person", lambda views, *_: (fit, views))
    monkeypatch.setattr(clothes, "_PATCH_STEPS", 1)
    monkeypatch.setattr(clothes, "_REGION_STEPS", 1)
    native = person(walk(4.0, 40))
    assert isinstance(native.deformation, Skinning)
    tree = np.array(native.deformation.parents)
    tree[16] = 12 if case == "tree" else tree[16]
    native = replace(native, deformation=replace(native.deformation, parents=tree))
    scene = street(native, tmp_path / "street")
    if case == "gone":
        (tmp_path / "street" / "poses.npz").unlink()
    if case == "changed":
        taller = replace(native.gaussians, means=1.1 * native.gaussians.means)
        skin = replace(native.deformation, joints=1.1 * native.deformation.joints)
        skeletons.write_files(
            tmp_path / "street", replace(native, gaussians=taller, deformation=skin)
        )
    if case == "unsaved":
        scene = replace(scene, low_pass=scene.low_pass)
    provenance = followed(scene, category, 5).provenance
    assert provenance.refinement is not None
    assert len(provenance.refinement.notes) == 1 and note in provenance.refinement.notes[0]
    assert provenance.refinement.notes[0] in provenance.refinement.explain()
    assert "body" not in provenance.details


@pytest.mark.parametrize("losses", [(0.2, 0.3, 0.4), (0.3, 0.25, 0.2)])
def test_a_skeleton_that_the_images_do_not_prefer_is_told(
    losses: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Losses of the parametric body, of the skeleton and of one crop."""
    fit = PersonFit(made_up.WALKER, np.zeros(2), 0.0, 0.2)
    monkeypatch.setattr(generator, "fit_person", lambda views, *_: (fit, views))
    monkeypatch.setattr(clothes, "_PATCH_STEPS", 1)
    monkeypatch.setattr(clothes, "_REGION_STEPS", 1)
    told = iter(losses)
    monkeypatch.setattr(generator, "_judged", lambda *_: next(told))
    provenance = followed(street(person(walk(4.0, 40)), tmp_path / "street"), images=5).provenance
    assert provenance.refinement is not None
    [note] = provenance.refinement.notes
    assert f"differ by {losses[1]:.3f} with it and by {min(losses):.3f} without" in note
    assert provenance.refinement.kept is (losses[0] < losses[2])
    assert "body" not in provenance.details
