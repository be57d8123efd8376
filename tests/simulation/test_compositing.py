"""Images put together by depth, against a reference that goes pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry.colour import linear_to_srgb, srgb_to_linear
from recast.simulation.oracle_renderer import (
    as_image,
    gaussians_in_truth,
    light_left,
    shaded,
    vehicle_in_street,
)

HEIGHT, WIDTH = 12, 17


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def image(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def values(rng: np.random.Generator, *channels: int) -> np.ndarray:
    return rng.random((HEIGHT, WIDTH, *channels), np.float32)


def some_none_all(rng: np.random.Generator) -> np.ndarray:
    """Shares (H, W) of which a third each is 0, between, and 1."""
    return np.clip(3 * values(rng) - 1, 0, 1)


def test_a_vehicle_in_a_street_pixel_by_pixel(rng: np.random.Generator) -> None:
    street, vehicle = values(rng, 3), image(rng)
    alpha, hides = some_none_all(rng), some_none_all(rng)
    front = values(rng, 3) * hides[..., None]
    found = vehicle_in_street(street, front, hides, vehicle, alpha)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        at = row, column
        over = front[at] + (1 - hides[at]) * vehicle[at] / 255
        light = alpha[at] * srgb_to_linear(over) + (1 - alpha[at]) * srgb_to_linear(street[at])
        expected = street[at] if alpha[at] == 0 else linear_to_srgb(light)
        # The curve of sRGB is at most 12.92 steep: some roundings of float32 times that.
        np.testing.assert_allclose(found[at], expected, atol=16 * 12.92 * 2**-24)
    np.testing.assert_array_equal(found[alpha == 0], street[alpha == 0])


def test_gaussians_in_the_truth_pixel_by_pixel(rng: np.random.Generator) -> None:
    truth, opacity = image(rng), some_none_all(rng)
    layer = values(rng, 3) * opacity[..., None]
    depth = 10 + 10 * values(rng)
    street = np.where(values(rng) < 0.2, np.inf, 10 + 10 * values(rng)).astype(np.float32)
    found = gaussians_in_truth(truth, street, layer, depth * opacity, opacity)
    covered = hidden = 0
    for at in np.ndindex(HEIGHT, WIDTH):
        nearer = depth[at] - 0.3 - 0.02 * depth[at]
        if abs(nearer - street[at]) < 1e-3:
            continue  # rounding decides
        if opacity[at] > 0 and nearer < street[at]:
            mixed = layer[at] + (1 - opacity[at]) * truth[at] / 255
            assert np.abs(found[at] - 255 * mixed).max() <= 0.5 + 1e-3
            covered += 1
        else:
            np.testing.assert_array_equal(found[at], truth[at])
            hidden += bool(opacity[at] > 0)
    assert covered > 20 and hidden > 20


def test_light_is_one_where_the_vehicle_changes_nothing(rng: np.random.Generator) -> None:
    without = image(rng)
    beside = without.copy()
    beside[:, :4] //= 2
    left = light_left(beside, without)
    np.testing.assert_array_equal(left[:, 9:], 1)  # beyond the reach of the blur
    assert (left[:, :3] < 1).all()
    street = values(rng, 3)
    dark = shaded(street, left)
    np.testing.assert_array_equal(dark[:, 9:], street[:, 9:])
    assert (dark[:, :3] < street[:, :3]).all()


@pytest.mark.parametrize("level", [60, 128, 250])
def test_a_street_that_is_the_truth_gets_the_true_shadow(level: int) -> None:
    without = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    beside = np.full_like(without, level // 2)
    found = as_image(shaded(without.astype(np.float32) / 255, light_left(beside, without)))
    # What keeps dark ratios finite adds 0.002 of linear light to both: less than a shadow's level.
    light = srgb_to_linear(np.array([level // 2, level]) / 255)
    bent = linear_to_srgb(light[1] * (light[0] + 2e-3) / (light[1] + 2e-3))
    assert np.abs(found.astype(int) - 255 * bent).max() <= 0.5 + 1e-2
    assert abs(255 * bent - level // 2) < 2


def test_one_ray_does_not_show(rng: np.random.Generator) -> None:
    without = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    beside = without.copy()
    beside[6, 8] = 100
    left = light_left(beside, without)
    single = srgb_to_linear(np.array(100 / 255)) / srgb_to_linear(np.array(128 / 255))
    assert left.min() > 1 - 0.2 * (1 - single)  # a Gaussian of one pixel has 0.16 at its centre
