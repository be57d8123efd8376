from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from actors import made_up
from recast.actors import Actor, insert, turntable
from recast.actors.shadow import contact_shadow
from recast.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.splats import Gaussians


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
    drawn = insert(scene, actor).at({"7": pose})
    vehicle, shadow = len(actor.gaussians), len(actor.shadow)
    assert len(drawn) == 10 + vehicle + shadow
    local = se3.apply(se3.inverse(pose), drawn.means[-shadow:].numpy())
    np.testing.assert_allclose(local, actor.shadow.means.numpy(), atol=1e-4)


def test_an_actor_the_scene_does_not_have(scene: StreetScene, actor: Actor) -> None:
    stranger = dataclasses.replace(actor, track_id="42")
    with pytest.raises(InputError, match="force_dynamic"):
        insert(scene, stranger)


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
