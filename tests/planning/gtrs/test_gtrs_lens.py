"""A pinhole renderer, bent, shows every ray where the distorted camera has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.cameras import PinholeCamera
from recast.cameras.mounts import NUPLAN_CAMERA
from recast.planning.gtrs import Lens

SMALL = NUPLAN_CAMERA.resized(240, 135)


def _painted(camera: PinholeCamera) -> np.ndarray:
    """Colours that are a smooth function of the direction."""
    x, y = np.moveaxis(camera.rays(camera.pixel_grid())[..., :2], -1, 0)
    colours = np.stack([128 + 120 * np.sin(3 * x), 128 + 120 * np.cos(2 * y), 128 + 90 * x], -1)
    return np.rint(colours).astype(np.uint8)


def test_every_ray_is_where_the_distortion_puts_it() -> None:
    lens = Lens(SMALL)
    assert lens.source.is_rectified and lens.source.fx == SMALL.fx
    bent = lens.bend(_painted(lens.source)).astype(int)
    expected = _painted(SMALL).astype(int)
    assert bent.shape == (135, 240, 3)
    assert np.abs(bent - expected).max() <= 2
    straight = _painted(SMALL.rectified()).astype(int)
    assert np.abs(straight - expected).max() > 10  # so that the comparison says something


def test_the_source_sees_just_enough() -> None:
    lens = Lens(SMALL)
    pixels, _ = lens.source.project(SMALL.rays(SMALL.pixel_grid()))
    assert pixels.min() >= 0.49
    assert (pixels.max((0, 1)) <= np.array([lens.source.width, lens.source.height]) - 0.49).all()
    assert lens.source.width < 1.4 * SMALL.width


def test_no_distortion_changes_nothing() -> None:
    camera = PinholeCamera(20, 12, 15.0, 15.0, 10.0, 6.0)
    lens = Lens(camera)
    assert lens.source == camera
    image = np.random.default_rng(0).integers(0, 256, (12, 20, 3), np.uint8)
    np.testing.assert_array_equal(lens.bend(image), image)


def test_other_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(12, 20\) pixels"):
        Lens(replace(SMALL, width=20, height=12, cx=10.0, cy=6.0, distortion=(0.0,) * 5)).bend(
            np.zeros((12, 24, 3), np.uint8)
        )
