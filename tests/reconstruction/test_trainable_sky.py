from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.reconstruction import SceneConfig
from recast.reconstruction.tables import CubeSky, PanoramaSky, make_sky
from recast.scene.sky import SkyMap, sample_cubemap, texel_directions

CAMERA = PinholeCamera(24, 16, 20.0, 22.0, 11.0, 9.0)
OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def smooth_sky() -> SkyMap:
    rows = torch.linspace(0, 1, 64)[:, None].expand(64, 128)
    turn = torch.linspace(-torch.pi, torch.pi, 129)[:-1].expand(64, 128)
    flat = 0.4 * (torch.pi * rows).sin()  # one colour at the poles
    return SkyMap(torch.stack([rows, 0.5 + flat * turn.cos(), 0.5 + flat * turn.sin()], dim=-1))


def test_texels_look_where_they_are_found() -> None:
    directions = texel_directions(5)
    faces = torch.rand(6, 5, 5, 3, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(sample_cubemap(faces, 3 * directions.view(-1, 3)), faces.view(-1, 3))


def test_a_cube_starts_as_the_map_and_comes_back_as_it() -> None:
    sky = CubeSky(smooth_sky(), 64)
    back = sky.sky_map()
    assert back.colours.shape == (128, 256, 3)
    rays = torch.randn(500, 3, generator=torch.Generator().manual_seed(1))
    assert (back(rays) - smooth_sky()(rays)).abs().max() < 0.05
    assert (back(rays) - smooth_sky()(rays)).abs().mean() < 0.005


@pytest.mark.parametrize("yaw", [0.3, 2.8])
def test_both_skies_draw_the_same_picture(yaw: float) -> None:
    pose = se3.from_rotation_translation(se3.rotation_z(yaw) @ OPENCV, [3.0, 2.0, 1.0])
    rgb = torch.rand(16, 24, 3, generator=torch.Generator().manual_seed(2))
    alpha = torch.rand(16, 24, generator=torch.Generator().manual_seed(3))
    alpha[4] = 1.0
    start = smooth_sky()
    images = [
        sky.behind(rgb, alpha, CAMERA, se3.inverse(pose))
        for sky in (CubeSky(start, 64), PanoramaSky(start))
    ]
    assert (images[0] - images[1]).abs().max() < 0.03
    assert torch.equal(images[0][4], rgb[4])


def test_gradients_of_a_cube_are_those_of_the_plain_expression() -> None:
    sky = CubeSky(SkyMap.constant(torch.tensor([0.3, 0.6, 0.9])), 8)
    alpha = torch.full((16, 24), 0.25, requires_grad=True)
    rgb = torch.zeros(16, 24, 3, requires_grad=True)
    sky.behind(rgb, alpha, CAMERA, np.eye(4)).sum().backward()
    assert alpha.grad is not None and rgb.grad is not None and sky.table.value.grad is not None
    assert torch.allclose(alpha.grad, torch.full((16, 24), -1.8))
    assert torch.equal(rgb.grad, torch.ones(16, 24, 3))
    seen = sky.table.value.grad.view(6, 64, 3).sum(dim=(1, 2))
    assert torch.allclose(seen.sum(), torch.tensor(0.75 * 3 * 16 * 24), rtol=1e-5)
    assert float(seen[4]) == float(seen.max()) and float(seen[5]) == 0  # looks along +z


def test_cells_that_no_pixel_shows_rest() -> None:
    sky = make_sky(SceneConfig(sky="cubemap", sky_face_px=8), smooth_sky())
    before = sky.table.value.detach().clone()
    image = sky.behind(torch.zeros(16, 24, 3), torch.zeros(16, 24), CAMERA, np.eye(4))
    image.sum().backward()
    sky.table.step(0.1)
    moved = (sky.table.value != before).any(dim=1).view(6, 64).sum(dim=1)
    assert moved[4] > 0 and moved[5] == 0
