"""Samples of light are spread as they should be."""

from __future__ import annotations

import numpy as np
import pytest

from recast.synthetic.rendering.rays import cosine_directions, disc_directions, pixel_samples


@pytest.mark.parametrize("block", [2, 4, 8])
def test_aligned_blocks_are_stratified(block: int) -> None:
    points = pixel_samples(16, 24, np.random.default_rng(0))
    for top in range(0, 16, block):
        for left in range(0, 24, block):
            part = points[top : top + block, left : left + block].reshape(-1, 2)
            origin = points[top // 8 * 8, left // 8 * 8]  # the net starts at (0, 0), then shifted
            part = (part - origin + 1e-4) % 1
            # One point in each of block x block cells.
            assert len({tuple(cell) for cell in (part * block).astype(int)}) == block * block


def test_cosine_directions_have_the_right_mean() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.6, 0.0, 0.8], np.float32)
    directions = cosine_directions(
        np.tile(normal, (20_000, 1)), rng.random((20_000, 2), np.float32)
    )
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
    cosine = directions @ normal
    assert cosine.min() > -1e-3
    assert np.allclose(directions.mean(axis=0), normal * 2 / 3, atol=0.01)


def test_disc_directions_stay_within_the_sun() -> None:
    centre = np.array([0.48, 0.6, 0.64])
    samples = np.random.default_rng(0).random((5000, 2), np.float32)
    angle = np.arccos(np.clip(disc_directions(centre, 0.02, samples) @ centre, -1, 1))
    assert angle.max() < 0.0201
    assert np.mean(angle < 0.02 / np.sqrt(2)) == pytest.approx(0.5, abs=0.03)
