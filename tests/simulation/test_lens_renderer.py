"""nuPlan's distorted rig through a renderer that knows pinhole cameras only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from recast.cameras import CameraMount, PinholeCamera
from recast.planning.gtrs import NUPLAN_VIRTUAL, nuplan_rig
from recast.simulation import NullRenderer
from recast.simulation.scene_renderer import LensRenderer, pinhole_mounts, through_lenses

STRAIGHT = {"front": CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4))}


class Painter(NullRenderer):
    """Each pixel's colour is a smooth function of the direction in the rig that it looks in."""

    def render(self, state: Any, camera_names: Sequence[str]) -> dict[str, np.ndarray]:
        return {name: paint(self.mounts[name]) for name in camera_names}


def paint(mount: CameraMount) -> np.ndarray:
    rays = mount.camera.rays(mount.camera.pixel_grid())
    directions = rays @ mount.rig_from_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.rint(128 + 120 * np.sin(2 * directions)).astype(np.uint8)


def test_every_pixel_of_the_rig_sees_what_it_should() -> None:
    rig = nuplan_rig(0.125)
    renderer = through_lenses(rig | STRAIGHT, Painter)
    assert renderer.mounts == rig | STRAIGHT
    images = renderer.render(None, (*rig, "front"))  # type: ignore[arg-type]
    for name, mount in rig.items():
        assert images[name].shape == (135, 240, 3)
        assert np.abs(images[name].astype(int) - paint(mount)).max() <= 2
    np.testing.assert_array_equal(images["front"], paint(STRAIGHT["front"]))
    assert set(renderer.render(None, ("front",))) == {"front"}  # type: ignore[arg-type]


def test_without_distortion_there_is_no_wrapper() -> None:
    made: list[Mapping[str, CameraMount]] = []

    def make(mounts: Mapping[str, CameraMount]) -> NullRenderer:
        made.append(mounts)
        return NullRenderer(mounts)

    assert isinstance(through_lenses(STRAIGHT, make), NullRenderer)
    assert isinstance(through_lenses(nuplan_rig(0.125), make), LensRenderer)
    assert made[0] == STRAIGHT
    assert all(mount.camera.is_rectified for mount in made[1].values())


def test_a_camera_wider_than_a_pinhole_is_put_together() -> None:
    # Barrel distortion: at the corners, 400 px from the centre, the ray is 70 degrees off.
    wide = PinholeCamera(320, 240, 100.0, 100.0, 160.0, 120.0, (-0.25, 0.045, 0.0, 0.0, -0.003))
    turned = nuplan_rig()["nuplan_l0"].rig_from_camera
    mount = CameraMount(wide, turned, source="front")
    parts = pinhole_mounts("wide", mount)
    assert list(parts)[:2] == ["wide", "wide, face 1"]
    assert {part.source for part in parts.values()} == {"front"}
    renderer = through_lenses({"wide": mount, **STRAIGHT}, Painter)
    images = renderer.render(None, ("wide", "front"))  # type: ignore[arg-type]
    assert set(images) == {"wide", "front"}
    assert np.abs(images["wide"].astype(int) - paint(mount)).max() <= 2


def test_the_rig_scales() -> None:
    small, full = nuplan_rig(0.5), nuplan_rig()
    assert tuple(small) == NUPLAN_VIRTUAL.cameras
    for name, mount in small.items():
        assert (mount.camera.width, mount.camera.height, mount.camera.fx) == (960, 540, 772.5)
        np.testing.assert_array_equal(mount.rig_from_camera, full[name].rig_from_camera)
