"""Disturbed images: what changes, and that it is the same each time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from recast.arrays import Image
from recast.cameras import CameraMount, PinholeCamera
from recast.simulation import NullRenderer, SimState
from recast.simulation.oracle_renderer import ImageNoise, NoisyRenderer, grey_noise
from recast.simulation.renderer import jittered

CAMERA = PinholeCamera(40, 30, 40.0, 40.0, 20.0, 15.0)
MOUNTS = {name: CameraMount(CAMERA, np.eye(4)) for name in ("front", "left")}
STATE = SimState(
    step=5,
    timestamp_us=0,
    ego=np.zeros(11),
    log_ego=np.zeros(4),
    world_from_rig=np.eye(4),
    track_id="7",
    actor=np.zeros(4),
    world_from_actor=np.eye(4),
)


class Pictures(NullRenderer):
    """The same random picture from every camera."""

    picture = np.random.default_rng(1).integers(0, 256, (30, 40, 3), np.uint8)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        return dict.fromkeys(camera_names, self.picture)


def test_every_pixel_goes_a_grey_level_up_or_down() -> None:
    picture = Pictures.picture
    found = grey_noise(picture, np.random.default_rng(2)).astype(int)
    change = found - picture
    inside = (picture > 0) & (picture < 255)
    assert set(np.unique(change[inside])) == {-1, 1}
    whole = inside.all(axis=2)
    assert (change[whole] == change[whole][:, :1]).all(), "channels go together"
    assert 0.4 < (change[inside] == 1).mean() < 0.6
    assert set(np.unique(change[picture == 0])) <= {0, 1}
    assert set(np.unique(change[picture == 255])) <= {-1, 0}


def test_the_jittered_picture_is_one_pixel_to_the_right() -> None:
    picture = Pictures.picture
    found = jittered(picture)
    np.testing.assert_array_equal(found[:, 1:], picture[:, :-1])
    np.testing.assert_array_equal(found[:, 0], picture[:, 0])


@pytest.mark.parametrize("noise", ["grey", "jitter"])
def test_images_depend_on_seed_camera_and_step_alone(noise: ImageNoise) -> None:
    renderer = NoisyRenderer(Pictures(MOUNTS), noise, 4)
    assert renderer.mounts == MOUNTS
    first = renderer.render(STATE, ["front", "left"])
    again = NoisyRenderer(Pictures(MOUNTS), noise, 4).render(STATE, ["left", "front"])
    for name in MOUNTS:
        np.testing.assert_array_equal(first[name], again[name])
    others = [
        first["left"],
        renderer.render(replace(STATE, step=6), ["front"])["front"],
        NoisyRenderer(Pictures(MOUNTS), noise, 5).render(STATE, ["front"])["front"],
    ]
    drawn = noise == "grey"
    assert [bool((other != first["front"]).any()) for other in others] == [drawn] * 3
