"""Formulas of single kinds against what they are meant to say."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry.colour import linear_to_srgb, srgb_to_linear
from recast.recar.perturb import PerturbationConfig
from recast.recar.perturb_camera import (
    ObjectBox,
    backdrop,
    convolve,
    disc_kernel,
    koschmieder,
    line_kernel,
    premultiplied,
    quality_between,
    resample,
    reveal,
    sensor_noise,
    shrinking,
    signed_distance,
    straight,
    through_jpeg,
    value_noise,
)
from recast.recar.perturb_outline import occlude


def red_square(side: int = 40, edge: int = 20) -> np.ndarray:
    rgba = np.zeros((side + 2 * edge, side + 2 * edge, 4), np.uint8)
    rgba[edge:-edge, edge:-edge] = (200, 40, 30, 255)
    return rgba


def test_light_round_trip() -> None:
    levels = np.arange(256, dtype=np.float32) / 255
    assert linear_to_srgb(srgb_to_linear(levels)) == pytest.approx(levels, abs=1e-5)


def test_straight_inverts_premultiplied() -> None:
    rgba = np.random.default_rng(0).integers(0, 256, (16, 16, 4)).astype(np.uint8)
    rgba[..., 3] = np.maximum(rgba[..., 3], 1)
    assert np.abs(straight(premultiplied(rgba)).astype(int) - rgba).max() <= 1


@pytest.mark.parametrize("radius", [0.0, 0.4, 3.0, 7.5])
def test_disc_has_its_area_and_no_offset(radius: float) -> None:
    kernel = disc_kernel(radius)
    offset = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert np.array_equal(kernel, kernel.T) and np.array_equal(kernel, kernel[::-1])
    spread = float((kernel.sum(axis=0) * offset**2).sum())
    if radius >= 3:  # a disc's variance along an axis is r^2 / 4
        assert spread == pytest.approx(radius**2 / 4, rel=0.15)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_line_has_its_length_and_direction(angle: float) -> None:
    kernel = line_kernel(24.0, angle)
    offset = np.arange(len(kernel)) - len(kernel) // 2
    along = offset[None, :] * np.cos(angle) + offset[:, None] * np.sin(angle)
    across = -offset[None, :] * np.sin(angle) + offset[:, None] * np.cos(angle)
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert float((kernel * along).sum()) == pytest.approx(0, abs=1e-3)
    assert float((kernel * along**2).sum()) == pytest.approx(24**2 / 12, rel=0.03)
    assert float((kernel * across**2).sum()) < 0.5
    assert line_kernel(0.0, angle).tolist() == [[1.0]]


@pytest.mark.parametrize("blur", ["disc", "small"])
def test_blur_neither_darkens_edges_nor_lets_transparent_colours_in(blur: str) -> None:
    rgba = red_square()
    rgba[rgba[..., 3] == 0] = (0, 255, 0, 0)
    out = convolve(rgba, disc_kernel(6), 9.0) if blur == "disc" else resample(rgba, 0.23, 1)
    seen = out[..., 3] > 0
    error = np.abs(out[seen][:, :3].astype(int) - (200, 40, 30)).max()
    assert error <= (1 if blur == "disc" else 6)


def test_blurred_mask_stays_sharp_and_in_place() -> None:
    rgba = red_square()
    out = convolve(rgba, disc_kernel(6), 9.0)
    row = out[40, :, 3].astype(int)
    assert np.count_nonzero((row > 25) & (row < 230)) <= 4
    assert np.count_nonzero(row > 127) == 40


def test_fog_is_koschmieders_law() -> None:
    light = np.full((2, 2, 3), 0.2, np.float32)
    air = np.array([0.5, 0.6, 0.7], np.float32)
    assert koschmieder(light, 1.0, air) == pytest.approx(light)
    assert koschmieder(light, 0.25, air)[0, 0] == pytest.approx([0.425, 0.5, 0.575])


def test_fog_leaves_the_contrast_that_its_visibility_says() -> None:
    """At the distance of the visibility two hundredths of the contrast are left."""
    fog = PerturbationConfig().fog.model_copy(
        update={"visibility_m": 100.0, "distance_m": (100.0, 100.0), "airlight": (0.5, 0.5)}
    )
    rgba = np.zeros((8, 40, 4), np.uint8)
    rgba[:, :20], rgba[:, 20:39] = (255, 255, 255, 255), (0, 0, 0, 255)
    out = srgb_to_linear(fog(rgba, 1.0, np.random.default_rng(0)).astype(np.float32) / 255)
    assert float(out[0, 0, 0] - out[0, 30, 0]) == pytest.approx(0.02, abs=0.005)


def test_noise_has_the_variance_of_shot_and_read_noise() -> None:
    light = np.full((200, 200, 3), 0.1, np.float32)
    noise = sensor_noise(light, 2000.0, 5.0, np.random.default_rng(1))
    assert float(noise.mean()) == pytest.approx(0, abs=2e-4)
    assert float(noise.std()) == pytest.approx(np.sqrt(200 + 25) / 2000, rel=0.03)


def test_jpeg_quality_follows_the_quantiser() -> None:
    assert [quality_between(95, 15, s) for s in (0.0, 1.0)] == [95, 15]
    # steps 0.1 and 10 / 3: their geometric mean is 0.577
    assert quality_between(95, 15, 0.5) == round(50 * (2 - np.sqrt(0.1 * 50 / 15)))


def test_jpeg_keeps_size_and_loses_more_at_low_quality() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (37, 53, 3)).astype(np.uint8)
    losses = []
    for quality in (95, 40, 10):
        out = through_jpeg(picture, quality, (3, 5))
        assert out.shape == picture.shape
        losses.append(np.abs(out.astype(int) - picture).mean())
    assert losses == sorted(losses)


def test_shrinking_is_geometric_and_never_enlarges() -> None:
    assert shrinking(400, 25, 0.5) == pytest.approx(0.25)
    assert shrinking(400, 25, 0.0) == 1.0
    assert shrinking(20, 25, 1.0) == 1.0


def test_signed_distance_counts_pixels_from_the_edge() -> None:
    alpha = np.zeros((1, 9), np.float32)
    alpha[0, 3:] = 1
    assert signed_distance(alpha)[0] == pytest.approx(
        [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5]
    )


def test_occluder_is_cut_out_but_for_its_fringe() -> None:
    rgba = red_square()
    coverage = np.zeros((80, 80), np.float32)
    coverage[:, 30:50] = 1
    clean = occlude(rgba, coverage, np.array([0.0, 0.0, 1.0]), 0.0)
    assert not clean[40, 30:50, 3].any()
    assert np.array_equal(clean[:, :30], rgba[:, :30]) and np.array_equal(
        clean[:, 50:], rgba[:, 50:]
    )
    fringed = occlude(rgba, coverage, np.array([0.0, 0.0, 1.0]), 3.0)
    assert fringed[40, 30].tolist() == [0, 0, 255, 255]
    assert not fringed[40, 36:44, 3].any()


def test_occluder_thinner_than_two_fringes_stays_in_the_mask() -> None:
    coverage = np.zeros((80, 80), np.float32)
    coverage[:, 38:42] = 1
    out = occlude(red_square(), coverage, np.array([0.0, 0.0, 1.0]), 4.0)
    assert np.array_equal(out[..., 3], red_square()[..., 3])
    assert out[40, 40, :3].tolist() == [0, 0, 255]


def test_reveal_shows_the_background_through_half_transparent_pixels() -> None:
    rgba = np.array([[[200, 200, 200, 128]]], np.uint8)
    out = reveal(rgba, np.ones((1, 1), np.float32), np.zeros((1, 1, 3), np.float32))
    assert out[0, 0].tolist() == [100, 100, 100, 255]
    same = reveal(rgba, np.full((1, 1), 128 / 255, np.float32), np.zeros((1, 1, 3), np.float32))
    assert np.array_equal(same, rgba)


def test_value_noise_is_standard_and_smooth() -> None:
    field = value_noise(300, 300, 12.0, np.random.default_rng(0))
    assert float(field.mean()) == pytest.approx(0, abs=0.1)
    assert float(field.std()) == pytest.approx(1, abs=0.25)
    assert float(np.abs(np.diff(field, axis=0)).max()) < 1.5


def test_backdrop_is_a_road_under_something_else() -> None:
    box = ObjectBox(40, 60, 100, 45)
    greys = []
    for seed in range(20):
        white = np.full((150, 180, 4), 255, np.uint8)
        street = backdrop(white, box, np.random.default_rng(seed))
        assert street.min() >= 0 and street.max() <= 1
        night = np.dstack([white[..., :3] // 8, white[..., 3]])
        dark = backdrop(night, box, np.random.default_rng(seed))
        assert np.abs(dark - street * (31 / 255 / 0.6)).max() <= 0.1
        greys.append(np.ptp(street[140:].mean(axis=(0, 1))))
    assert max(greys) < 0.06  # asphalt has hardly any colour
