from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.reconstruction.first_points import sky_mask
from recast.scene.sky import (
    OPAQUE,
    SkyMap,
    composite,
    direction_coordinates,
    fused_composite,
    pixel_coordinates,
    sky_from_pixels,
)


def direction(azimuth: float, elevation: float) -> torch.Tensor:
    flat = math.cos(elevation)
    return torch.tensor([[flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)]])


@given(
    azimuth=st.floats(-math.pi, math.pi),
    elevation=st.floats(-math.pi / 2, math.pi / 2),
)
def test_a_constant_map_is_constant(azimuth: float, elevation: float) -> None:
    ray = direction(azimuth, elevation)
    colour = torch.tensor([0.2, 0.5, 0.9])
    assert torch.allclose(SkyMap.constant(colour, 16, 32)(3 * ray)[0], colour, atol=1e-5)


def test_no_seam_behind() -> None:
    generator = torch.Generator().manual_seed(1)
    sky = SkyMap(torch.rand(16, 32, 3, generator=generator))
    left, right = direction(math.pi - 1e-5, 0.3), direction(-math.pi + 1e-5, 0.3)
    assert torch.allclose(sky(left), sky(right), atol=1e-3)


def test_up_is_row_zero_and_azimuth_grows_to_the_right() -> None:
    colours = torch.zeros(16, 32, 3)
    colours[0, :, 0] = 1  # zenith red
    colours[8, 24, 1] = 1  # a quarter turn to the left of x, just below the horizon: green
    sky = SkyMap(colours)
    assert sky(torch.tensor([[0.0, 0.0, 1.0]]))[0, 0] > 0.9
    centre = direction((24.5 / 32) * 2 * math.pi - math.pi, math.pi / 2 - 8.5 / 16 * math.pi)
    assert centre[0, 1] > 0.9  # y is left
    assert torch.allclose(sky(centre)[0, 1], torch.tensor(1.0), atol=1e-4)


def naive_lookup(colours: torch.Tensor, ray: torch.Tensor) -> torch.Tensor:
    """Bilinear by hand: cell centres at +0.5, columns wrap, rows end."""
    height, width = colours.shape[:2]
    x, y, z = ray.tolist()
    column = (math.atan2(y, x) + math.pi) / (2 * math.pi) * width - 0.5
    row = (math.pi / 2 - math.atan2(z, math.hypot(x, y))) / math.pi * height - 0.5
    row = min(max(row, 0), height - 1)
    left, top = math.floor(column), math.floor(row)
    result = torch.zeros(3)
    for r, wr in ((top, 1 - (row - top)), (min(top + 1, height - 1), row - top)):
        for c, wc in ((left, 1 - (column - left)), (left + 1, column - left)):
            result = result + wr * wc * colours[r, c % width]
    return result


@pytest.mark.parametrize("put", [composite, fused_composite])
def test_composite_matches_the_plain_expression(put: Callable[..., torch.Tensor]) -> None:
    generator = torch.Generator().manual_seed(2)
    rgb, alpha = (torch.rand(*s, generator=generator) for s in ((5, 7, 3), (5, 7)))
    alpha[0, 0] = 1.0  # opaque: no sky there
    colours = torch.rand(8, 16, 3, generator=generator)
    directions = torch.randn(5, 7, 3, generator=generator)
    weights = torch.rand(5, 7, 3, generator=generator)
    leaves = [t.clone().requires_grad_() for t in (rgb, alpha, colours)]
    plain = [t.clone().requires_grad_() for t in (rgb, alpha, colours)]
    image = put(*leaves, direction_coordinates(directions))
    (image * weights).sum().backward()
    shown = (plain[1] < OPAQUE)[..., None]
    sky = torch.stack([naive_lookup(plain[2], ray) for ray in directions.view(-1, 3)])
    expected = plain[0] + torch.where(shown, (1 - plain[1])[..., None] * sky.view(5, 7, 3), 0.0)
    (expected * weights).sum().backward()
    assert torch.allclose(image, expected, atol=1e-5)
    for own, other in zip(leaves, plain, strict=True):
        assert own.grad is not None and other.grad is not None
        assert torch.allclose(own.grad, other.grad, atol=1e-5)


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi - 0.1, -math.pi])
def test_pixels_look_where_their_rays_go(yaw: float) -> None:
    camera = PinholeCamera(621, 188, 361.0, 361.0, 305.0, 87.0)
    opencv = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt = se3.exp(np.array([0, 0, 0, 0.05, -0.1, 0]))[:3, :3]
    pose = se3.from_rotation_translation(se3.rotation_z(yaw) @ tilt @ opencv, [3.0, 2.0, 1.0])
    fast = pixel_coordinates(camera, se3.inverse(pose))
    rays = camera.rays(camera.pixel_grid()) @ pose[:3, :3].T
    exact = direction_coordinates(torch.from_numpy(rays))
    gap = (fast - exact).double()
    gap[..., 0] -= gap[..., 0].round()  # a whole turn is no difference
    assert gap[..., 0].abs().max() * 512 < 0.01
    assert gap[..., 1].abs().max() * 128 < 0.01


def test_distorted_cameras_are_refused() -> None:
    camera = PinholeCamera(8, 8, 9.0, 9.0, 4.0, 4.0, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="rectified"):
        pixel_coordinates(camera, np.eye(4))


def test_first_sky_has_the_seen_colours_and_no_holes() -> None:
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(-0.5, 0.5, 4000), rng.uniform(0.1, 0.4, 4000)
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).astype(np.float32)
    colours = np.stack([0.5 + azimuth, np.full(4000, 0.6), elevation], -1).astype(np.float32)
    sky = sky_from_pixels(rays, colours)
    seen = sky(torch.from_numpy(rays)).numpy()
    assert np.abs(seen - np.clip(colours, 0, 1)).mean() < 0.02
    behind = sky(direction(math.pi, 0.5))[0]
    assert torch.isfinite(sky.colours).all() and abs(float(behind[1]) - 0.6) < 0.05


def test_mask_takes_the_bright_top_and_leaves_walls_and_returns() -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    image[:20] = (190, 210, 240)
    image[5:20, 10:20] = (200, 120, 80)  # a warm wall before the sky
    image[25:30, 30:50] = (200, 215, 240)  # a bright thing that does not reach the top
    occupied = np.zeros((40, 60), bool)
    occupied[:20, 50:] = True  # LiDAR returns: no sky
    mask = sky_mask(image, occupied)
    assert mask[2:15, 25:45].all() and mask[0, 30]
    assert not mask[:, 10:20][5:].any()
    assert not mask[21:].any() and not mask[:, 50:].any()


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("size", [(1, 1), (2, 5), (16, 32)])
def test_compiled_composite_matches_reference(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(3)
    rgb, alpha = (torch.rand(*s, generator=generator) for s in ((70, 90, 3), (70, 90)))
    alpha[:20] = 1.0
    alpha[30:] = 0.0
    colours = torch.rand(*size, 3, generator=generator)
    coordinates = 3 * torch.rand(70, 90, 2, generator=generator) - 1  # beyond the turn and the rows
    coordinates[40, :6] = torch.tensor([0.0, 1.0, -1e-9, 0.5, 1 - 2**-24, -1.0])[:, None]
    weights = torch.rand(70, 90, 3, generator=generator)
    leaves = [one.clone().requires_grad_() for one in (rgb, alpha, colours)]
    plain = [one.double().requires_grad_() for one in (rgb, alpha, colours)]
    image = fused_composite(*leaves, coordinates)
    (image * weights).sum().backward()
    expected = composite(*plain, coordinates.double())
    (expected * weights).sum().backward()
    # A place on the map is off by 4 roundings of its share times the width: weights by as much,
    # colours by twice that; of a cell, as many pixels as see it add up.
    place = 4 * 2.0**-24 * 2 * max(size)
    assert ((image - expected).abs() <= 2 * place + 4 * 2.0**-24).all()
    for own, other in zip(leaves, plain, strict=True):
        assert own.grad is not None and other.grad is not None
        pixels = 3 if other is not plain[2] else weights.sum()
        assert ((own.grad - other.grad).abs() <= pixels * (2 * place + 4 * 2.0**-24)).all()


def test_composite_checks_shapes() -> None:
    with pytest.raises(ValueError, match="composite"):
        fused_composite(
            torch.zeros(4, 5, 3), torch.zeros(4, 5), torch.zeros(2, 2, 3), torch.zeros(4, 4, 2)
        )
