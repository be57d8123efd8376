"""Lenses of any kind by pinhole images: every ray is where it belongs, beyond them it is black."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.arrays import Array
from recast.cameras import Lens, LensCamera, PinholeCamera, RadialLens, RationalLens
from recast.cameras.lenses import fisheye_lens, ftheta_lens

FRONT = ftheta_lens(192, 108, 96.3, 53.6, (0.0, 1.08e-2, -2e-6, 2e-8), "angle", 1.2)
AROUND = fisheye_lens(160, 160, 40.0, 40.0, 80.0, 80.0, (0.01, -0.001), 2.4)
ABOVE = fisheye_lens(60, 240, 70.0, 70.0, 30.0, 120.0, (), 3.0)
RATIONAL = RationalLens(160, 90, 90.0, 91.0, 80.0, 45.0, (0.3, 0.1, 0.02, 0.35, 0.12, 0.03))
LENSES = {"front": FRONT, "around": AROUND, "above": ABOVE, "rational": RATIONAL}


def paint(rays: np.ndarray) -> np.ndarray:
    """Colours that are a smooth function of the direction; black without one."""
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.rint(128 + 120 * np.sin(2 * np.nan_to_num(directions, nan=-np.arcsin(1)))).astype(
        np.uint8
    ) * np.isfinite(rays[..., :1])


def grid(camera: LensCamera) -> np.ndarray:
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([u, v], axis=-1)


@pytest.mark.parametrize("name", LENSES)
def test_every_pixel_shows_its_ray(name: str) -> None:
    camera: LensCamera = LENSES[name]
    lens = Lens(camera)
    images = []
    for face in lens.faces:
        assert face.camera.is_rectified
        assert (face.camera.fx, face.camera.fy) == (camera.fx, camera.fy)
        rays = face.camera.rays(face.camera.pixel_grid()) @ face.face_from_lens
        images.append(paint(rays).astype(np.uint8))
    found, wanted = lens.bend(*images), paint(camera.rays(grid(camera)))
    # Half a level of rounding twice, 1/64 of a pixel of OpenCV's maps, and the curve between two
    # pixels that are 1/40 apart: 240 / 40 / 64 and 480 / 40^2 / 8 levels.
    assert np.abs(found.astype(int) - wanted.astype(int)).max() <= 2


def test_faces_are_as_many_as_are_needed() -> None:
    assert len(Lens(RATIONAL).faces) == 1
    assert len(Lens(RATIONAL.resized(80, 60)).faces) == 1
    assert len(Lens(replace(FRONT, polynomial=(0.0, 9e-3))).faces) == 1
    assert len(Lens(FRONT).faces) == 3  # 122 degrees
    sides = Lens(AROUND).faces
    assert len(sides) == 6
    turns = np.stack([face.face_from_lens for face in sides])
    np.testing.assert_array_equal(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_array_equal(np.linalg.det(turns), np.ones(6))


def test_beyond_the_limit_it_is_black() -> None:
    lens = Lens(fisheye_lens(100, 100, 80.0, 80.0, 50.0, 50.0, (), 0.5))
    (face,) = lens.faces
    image = lens.bend(np.full((face.camera.height, face.camera.width, 3), 255, np.uint8))
    inside = np.linalg.norm(grid(lens.camera) - 50.0, axis=-1) <= 40.0  # 80 px/rad for 0.5 rad
    for channel in range(3):
        np.testing.assert_array_equal(image[..., channel], 255 * inside)
    assert max(face.camera.width, face.camera.height) <= 2 * 80 * np.tan(0.5) + 2


def test_a_lens_that_sees_nothing_is_black() -> None:
    lens = Lens(fisheye_lens(10, 8, 80.0, 80.0, 500.0, 500.0, (), 0.5))
    assert lens.faces == ()
    np.testing.assert_array_equal(lens.bend(), np.zeros((8, 10, 3), np.uint8))


def test_sizes_are_checked_before_images_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    # The axis is magnified a thousandfold against the edge.
    steep = ftheta_lens(200, 200, 100.0, 100.0, (0.0, 1e-4, 1e-4), "angle", 1.0)
    with pytest.raises(ValueError, match="needs pinhole images of over"):
        Lens(steep, 1_000_000)
    directions = RadialLens.rays
    pixels = []

    def counted(lens: RadialLens, uv: Array) -> Array:
        pixels.append(uv[..., 0].size)
        return directions(lens, uv)

    monkeypatch.setattr(RadialLens, "rays", counted)
    with pytest.raises(ValueError, match="needs pinhole images of over"):
        Lens(steep.resized(3840, 2160), 80_000_000)
    assert sum(pixels) < 5000  # of 8 million
    monkeypatch.undo()
    with pytest.raises(ValueError, match="expected 6 images, got 1"):
        Lens(AROUND).bend(np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ValueError, match=r"Lens\.source: it has 6 faces"):
        _ = Lens(AROUND).source
    camera = PinholeCamera(20, 12, 15.0, 15.0, 10.0, 6.0)
    assert Lens(camera).source == camera
