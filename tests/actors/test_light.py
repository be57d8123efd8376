from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from recast.actors import Actor, insert
from recast.actors.actor import Shares
from recast.actors.insert import actor_light
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene import SceneActor, SkyMap, StreetScene, render_scene
from recast.scene.light import ActorLight, SceneLight, SunBelief, recorded_light
from recast.scene.light.relight import LitSurface
from recast.scene.light.sun import directions
from recast.splats import Gaussians
from support import made_up_actors as made_up


@pytest.fixture
def scene(street: DrivingLog, red_car: Gaussians) -> StreetScene:
    native = SceneActor("7", red_car, made_up.SIZE, street.tracks["7"].trajectory)
    nothing = red_car.select(torch.zeros(0, dtype=torch.int64))
    return StreetScene(nothing, {"7": native}, SkyMap.constant(torch.full((3,), 0.8)))


@pytest.fixture
def lit_from_the_left(scene: StreetScene) -> SceneLight:
    """A street whose sun stands at 40 degrees on the left of its driving direction, for sure."""
    towards, _ = directions()
    heading = float(se3.yaw(scene.actors["7"].trajectory.poses[0])) + np.pi / 2
    wanted = np.array([np.cos(heading), np.sin(heading), np.tan(np.radians(40.0))])
    sun = SunBelief(np.eye(len(towards))[(towards @ wanted / np.linalg.norm(wanted)).argmax()])
    return dataclasses.replace(SceneLight.of(scene), sun=sun)


def shared(actor: Actor, seen: float, mirrored: float) -> Actor:
    count = len(actor.gaussians)
    return dataclasses.replace(
        actor, shares=Shares(torch.full((count,), seen), torch.full((count,), mirrored))
    )


def light_of(light: SceneLight, actor: Actor, scene: StreetScene) -> ActorLight:
    return actor_light(light, actor, scene.actors["7"].trajectory)


def test_normals_face_outwards(
    scene: StreetScene, lit_from_the_left: SceneLight, actor: Actor
) -> None:
    normals = light_of(lit_from_the_left, actor, scene).surface.normals.numpy()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    points = actor.gaussians.means.numpy()
    half = made_up.SIZE / 2
    doors = (np.abs(points[:, 0]) < 0.5) & (np.abs(points[:, 1]) > 0.85 * half[1])
    doors &= np.abs(points[:, 2]) < 0.2
    assert (np.sign(points[doors, 1]) * normals[doors, 1]).mean() > 0.8
    roof = (points[:, 2] > 0.9 * half[2]) & (np.abs(points[:, 1]) < 0.4)
    assert normals[roof, 2].mean() > 0.8


def test_what_was_seen_has_the_light_of_its_side_and_what_is_mirrored_of_the_other(
    scene: StreetScene, lit_from_the_left: SceneLight, actor: Actor
) -> None:
    seen = light_of(lit_from_the_left, shared(actor, 1.0, 0.0), scene)
    # half of everything was seen, half is mirrored: the mean of both sides
    both = light_of(lit_from_the_left, shared(actor, 0.5, 0.5), scene)
    poses = list(scene.actors["7"].trajectory.poses)
    own = recorded_light(lit_from_the_left, seen.surface, made_up.SIZE, poses)
    torch.testing.assert_close(seen.recorded, own)
    flipped = LitSurface.of(
        seen.surface.normals * torch.tensor([1.0, -1.0, 1.0]), actor.gaussians.means, made_up.SIZE
    )
    twin = recorded_light(lit_from_the_left, flipped, made_up.SIZE, poses)
    torch.testing.assert_close(both.recorded, (own + twin) / 2)
    left = seen.surface.normals[:, 1] > 0.8
    right = seen.surface.normals[:, 1] < -0.8
    assert own[left].mean() > 2 * own[right].mean()


def test_what_is_invented_has_the_mean_light_of_what_was_seen(
    scene: StreetScene, lit_from_the_left: SceneLight, actor: Actor
) -> None:
    hardly = light_of(lit_from_the_left, shared(actor, 0.01, 0.0), scene)
    normals = hardly.surface.normals
    left, right = normals[:, 1] > 0.8, normals[:, 1] < -0.8
    assert hardly.recorded[left].mean() == pytest.approx(
        float(hardly.recorded[right].mean()), rel=0.1
    )


def test_weights_of_poses(lit_from_the_left: SceneLight) -> None:
    """Once along the road and once across it, the second three times as long."""
    normals = torch.tensor([[0.0, 1.0, 0.0]])
    surface = LitSurface.of(normals, torch.zeros(1, 3), made_up.SIZE)
    poses = [se3.from_rotation_translation(se3.rotation_z(a), [0, 0, 1.0]) for a in (0.35, 2.0)]
    one, two = (recorded_light(lit_from_the_left, surface, made_up.SIZE, [p]) for p in poses)
    both = recorded_light(lit_from_the_left, surface, made_up.SIZE, poses, [1.0, 3.0])
    torch.testing.assert_close(both, 0.25 * one + 0.75 * two)


def test_an_inserted_actor_is_lit_where_it_stands_and_drawn_so(
    scene: StreetScene, actor: Actor
) -> None:
    lit = insert(scene, actor)
    assert insert(scene, actor, relit=False).actors["7"].light is None
    assert isinstance(lit.actors["7"].light, ActorLight)
    assert lit.actors["7"].gaussians is actor.gaussians  # what is kept is the recorded look
    pose = se3.from_rotation_translation(se3.rotation_z(2.0), [9.0, 0.0, made_up.SIZE[2] / 2])
    camera_from_world = se3.inverse(made_up.RIG_FROM_CAMERA)
    drawn = render_scene(lit, made_up.CAMERA, camera_from_world, {"7": pose}).rgb
    there = lit.with_actor(lit.actors["7"].lit_at(pose))
    expected = render_scene(there, made_up.CAMERA, camera_from_world, {"7": pose}).rgb
    np.testing.assert_array_equal(drawn, expected)
    again = render_scene(insert(scene, actor), made_up.CAMERA, camera_from_world, {"7": pose}).rgb
    np.testing.assert_array_equal(drawn, again)
