from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.actors import Actor, insert, turntable
from recast.actors.insert import contact_shadow
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene import (
    SceneActor,
    SkyMap,
    StreetScene,
    load_scene,
    render_scene,
    save_scene,
)
from recast.splats import CLASSIC, MIP, Gaussians, rasterize
from support import made_up_actors as made_up


@pytest.fixture
def scene(street: DrivingLog, red_car: Gaussians) -> StreetScene:
    native = SceneActor("7", red_car, made_up.SIZE, street.tracks["7"].trajectory)
    ground = red_car.select(torch.arange(10))
    return StreetScene(ground, {"7": native}, SkyMap.constant(torch.zeros(3)), log_name="made up")


def test_model_is_replaced_and_poses_kept(scene: StreetScene, actor: Actor) -> None:
    changed = insert(scene, actor)
    assert changed.actors["7"].gaussians is actor.gaussians
    assert changed.actors["7"].trajectory is scene.actors["7"].trajectory
    assert scene.actors["7"].shadow is None  # the old scene is untouched


def test_shadow_moves_with_the_vehicle(scene: StreetScene, actor: Actor) -> None:
    pose = se3.from_rotation_translation(se3.rotation_z(0.7), [5.0, -3.0, 1.0])
    drawn = insert(scene, actor, relit=False).at({"7": pose})
    vehicle, shadow = len(actor.gaussians), len(actor.shadow)
    assert len(drawn) == 10 + vehicle + shadow
    local = se3.apply(se3.inverse(pose), drawn.means[-shadow:].numpy())
    np.testing.assert_allclose(local, actor.shadow.means.numpy(), atol=1e-4)


def test_an_actor_the_scene_does_not_have(scene: StreetScene, actor: Actor) -> None:
    stranger = dataclasses.replace(actor, track_id="42")
    with pytest.raises(InputError, match="force_dynamic"):
        insert(scene, stranger)


@pytest.mark.parametrize("distance", [8.0, 20.0, 45.0])
def test_a_scene_draws_an_actor_as_through_its_own_filter(
    scene: StreetScene, actor: Actor, distance: float
) -> None:
    """Made for Mip-Splatting's filter, drawn in the scene's pass, by the filter of 3DGS."""
    shadow = actor.shadow.select(torch.zeros(0, dtype=torch.int64))
    vehicle = dataclasses.replace(actor, low_pass=MIP, shadow=shadow)
    nothing = actor.gaussians.select(torch.zeros(0, dtype=torch.int64))
    empty = dataclasses.replace(scene, background=nothing)
    pose = se3.from_rotation_translation(se3.rotation_z(0.6), [distance, 0.0, 0.0])
    camera_from_world = se3.inverse(made_up.RIG_FROM_CAMERA)

    def image(inserted: Actor) -> np.ndarray:
        placed = insert(empty, inserted, relit=False)
        return render_scene(placed, made_up.CAMERA, camera_from_world, {"7": pose}).rgb

    camera = made_up.CAMERA
    with torch.no_grad():
        own = rasterize(
            vehicle.gaussians.transformed(torch.from_numpy(pose)),
            torch.from_numpy(camera_from_world).float(),
            torch.from_numpy(camera.matrix).float(),
            camera.width,
            camera.height,
            eps2d=0.1,
            antialiased=True,
        )
    wanted, covered = own.rgb.clamp(0, 1).numpy(), own.alpha.numpy() > 0.5
    kept = np.abs(image(vehicle) - wanted)[covered].mean()
    ignored = np.abs(image(dataclasses.replace(vehicle, low_pass=CLASSIC)) - wanted)[covered].mean()
    assert kept < 0.5 * ignored


def test_a_saved_scene_keeps_the_filter_of_its_actors(
    scene: StreetScene, actor: Actor, tmp_path: Path
) -> None:
    save_scene(insert(scene, dataclasses.replace(actor, low_pass=MIP)), tmp_path / "scene")
    assert load_scene(tmp_path / "scene").actors["7"].low_pass == MIP


def test_shadow_is_black_flat_soft_and_larger_than_the_footprint() -> None:
    low, high = np.array([-2.2, -0.9, -0.7]), np.array([2.0, 0.9, 0.7])
    shadow = contact_shadow(low, high, floor=-0.7)
    shadow.validate()
    colour = 0.5 + 0.28209479177387814 * shadow.sh[:, 0]
    assert colour.abs().max() < 1e-6
    assert shadow.log_scales[:, 2].exp().max() < 0.01
    height = shadow.means[:, 2]
    assert height.min() > -0.7 and height.max() < -0.6
    opacity = torch.sigmoid(shadow.logit_opacities)
    middle = (shadow.means[:, :2] - torch.tensor([-0.1, 0.0])).norm(dim=1) < 0.3
    rim = shadow.means[:, 1].abs() > 0.9
    assert opacity[middle].min() > 0.4
    assert rim.any()
    assert opacity[rim].max() < 0.5 * opacity[middle].min()


def test_turntable_goes_round_the_car(actor: Actor) -> None:
    images = turntable(actor, views=4, width=160, height=90)
    assert [image.shape for image in images] == [(90, 160, 3)] * 4
    assert all(image.dtype == np.uint8 for image in images)

    def red_columns(image: np.ndarray) -> int:
        red = image[..., 0].astype(int) - image[..., 1:].max(axis=2) > 30
        return int(red.any(axis=0).sum())

    front, left, rear, right = (red_columns(image) for image in images)
    assert left > 1.6 * front and right > 1.6 * rear
    assert front > 15
    # the car is whole: its colour does not reach the border
    for image in images:
        border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
        assert np.ptp(border.astype(int), axis=0).max() < 12


def test_validate_names_the_field(actor: Actor) -> None:
    actor.validate()
    with pytest.raises(ValueError, match=r"Actor\.size"):
        dataclasses.replace(actor, size=np.array([1.0, -1.0, 1.0])).validate()
    with pytest.raises(ValueError, match=r"Actor\.source"):
        dataclasses.replace(actor, source=actor.source[..., :3]).validate()
