from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.reconstruction import SceneConfig
from recast.reconstruction.settings import INIT, coarse_factor
from recast.reconstruction.views import DepthSamples, TrainingView, make_level

CAMERA = PinholeCamera(61, 38, 50.0, 50.0, 30.0, 19.0)


def made_up(masked: bool) -> tuple[TrainingView, np.ndarray, DepthSamples]:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (38, 61, 3), np.uint8)
    mask = None
    if masked:
        mask = np.ones((38, 61), bool)
        mask[30:] = False
    sky = np.zeros((38, 61), bool)
    sky[:9, 5:50] = True
    uv = rng.uniform(0, 1, (500, 2)) * [61, 38]
    samples = DepthSamples(rng.uniform(2, 60, 500).astype(np.float32), uv.astype(np.float32))
    return TrainingView("front", 0, 0, CAMERA, np.eye(4), image, mask, False), sky, samples


@pytest.mark.parametrize("masked", [False, True])
def test_what_is_packed_comes_out_again(masked: bool) -> None:
    view, sky, samples = made_up(masked)
    level = make_level(view, sky, ~sky, samples).unpacked()
    shown = view.image if view.mask is None else view.image * view.mask[..., None]
    assert torch.equal(level.target, torch.from_numpy(shown).float() * (1 / 255))
    assert level.sky.tolist() == np.flatnonzero(sky).tolist()
    assert level.ground.tolist() == np.flatnonzero(~sky).tolist()
    assert (level.usable is None) != masked
    pixels = samples.uv.astype(int) @ [1, 61]
    assert level.depth_pixels.tolist() == pixels.tolist()
    assert torch.equal(level.depths, torch.from_numpy(samples.depths))


@pytest.mark.parametrize("factor", [2, 4])
def test_coarser_masks_hold_whole_pixels_only(factor: int) -> None:
    view, sky, samples = made_up(True)
    level = make_level(view, sky, None, samples, factor).unpacked()
    height, width = 38 // factor, 61 // factor
    assert level.target.shape == (height, width, 3) and level.camera.width == width
    rows, columns = level.sky // width, level.sky % width
    assert (rows + 1).max() * 38 / height <= 9 + 1e-6
    assert columns.min() * 61 / width >= 5 - 1e-6 and len(level.ground) == 0
    assert level.usable is not None and not level.usable[-1].any() and level.usable[0].all()
    assert level.depth_pixels.max() < height * width and len(level.depths) == 500


def test_a_waiting_view_is_small() -> None:
    """3 bytes a pixel, a bit a pixel for each mask, 8 bytes a depth: the memory rule of docs."""
    view, sky, _ = made_up(True)
    many = np.full(50_000, 5.0, np.float32)
    samples = DepthSamples(many, np.full((50_000, 2), 3.0, np.float32))
    level = make_level(view, sky, ~sky, samples)
    pixels = 38 * 61
    assert level.image is view.image  # the view's own, not a copy
    held = sum(one.nbytes for one in vars(level).values() if isinstance(one, np.ndarray))
    assert held <= 3 * pixels + 3 * (pixels + 7) // 8 + 8 * INIT.most_depths
    assert held > 3 * pixels + 8 * 9_000


def test_each_factor_has_an_equal_part_of_the_coarse_run() -> None:
    config = SceneConfig(coarse_fraction=0.2, coarse_factors=(4, 2))
    assert [coarse_factor(config, u) for u in (0, 0.09, 0.11, 0.19, 0.2, 1)] == [4, 4, 2, 2, 1, 1]
    assert coarse_factor(SceneConfig(coarse_fraction=0), 0.0) == 1
    assert coarse_factor(SceneConfig(), 0.14) == 2
