from __future__ import annotations

import math

import numpy as np
import pytest

from recast.reconstruction import psnr, ssim


def naive_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Pixel by pixel, window by window, from the formula."""
    offsets = np.arange(-5, 6)
    weight = np.exp(-(offsets**2) / (2 * 1.5**2))
    weight = np.outer(weight, weight) / weight.sum() ** 2
    padded_x, padded_y = (np.pad(image, ((5, 5), (5, 5), (0, 0))) for image in (x, y))
    total = 0.0
    for r in range(x.shape[0]):
        for c in range(x.shape[1]):
            for k in range(3):
                a, b = padded_x[r : r + 11, c : c + 11, k], padded_y[r : r + 11, c : c + 11, k]
                ma, mb = (weight * a).sum(), (weight * b).sum()
                va, vb = (weight * a * a).sum() - ma**2, (weight * b * b).sum() - mb**2
                cov = (weight * a * b).sum() - ma * mb
                total += ((2 * ma * mb + 1e-4) * (2 * cov + 9e-4)) / (
                    (ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)
                )
    return total / x.size


def test_psnr_of_a_known_error() -> None:
    image = np.full((4, 5, 3), 0.5)
    assert psnr(image, image + 0.01) == pytest.approx(40.0)
    assert psnr(image, image) == math.inf


def test_ssim_follows_the_formula() -> None:
    rng = np.random.default_rng(3)
    x = rng.random((13, 17, 3))
    y = np.clip(x + rng.normal(0, 0.1, x.shape), 0, 1)
    assert ssim(x, y) == pytest.approx(naive_ssim(x, y), abs=1e-12)
    assert ssim(x, x) == pytest.approx(1.0)


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match="shape"):
        ssim(np.zeros((4, 4, 3)), np.zeros((4, 5, 3)))
