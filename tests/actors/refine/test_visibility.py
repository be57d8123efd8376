from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from actors import made_up_evidence
from recast.actors.actor import Shares
from recast.actors.refine.images import (
    Layers,
    follow_paint,
    make_layers,
    pixel_weights,
    visibility_of,
)
from recast.scene.actor import draw
from recast.splats import CLASSIC, Gaussians
from recast.splats.gaussians import C0

FROM_LEFT = np.linspace(0.3, 0.7, 6) * np.pi


@pytest.fixture(scope="module")
def layers(red_car: Gaussians) -> list[Layers]:
    seen = made_up_evidence.evidence(red_car, FROM_LEFT)
    nothing = red_car.select(torch.zeros(0, dtype=torch.int64))
    return make_layers(made_up_evidence.empty_street(red_car, 6), seen, nothing)


def test_weights_are_the_picture_s_opacity(red_car: Gaussians, layers: list[Layers]) -> None:
    """All transmittance times alpha together is what the rasterizer calls alpha."""
    view = layers[0]
    camera = view.sighting.camera
    pixels = torch.rand(camera.height, camera.width, generator=torch.Generator().manual_seed(0))
    weights = pixel_weights(red_car, CLASSIC, view, pixels)
    alpha = draw(red_car, view.camera_from_world, camera).alpha
    wanted = float((alpha * pixels).sum())
    assert float(weights.sum()) == pytest.approx(wanted, rel=1e-4)
    assert float(weights.min()) >= 0


def test_layers_put_the_picture_together_again(red_car: Gaussians, layers: list[Layers]) -> None:
    view = layers[2]
    camera = view.sighting.camera
    drawn = draw(red_car, view.camera_from_world, camera)
    shown = view.around(drawn.rgb, drawn.alpha).clamp(0, 1)
    # The image was quantised; its gain is that of an even grey, which is one.
    difference = (shown - torch.from_numpy(view.sighting.image).float() / 255).abs()
    assert float(difference.max()) < 2 / 255 + 1e-3


def test_one_side_is_seen_the_other_mirrored_the_rest_invented(
    red_car: Gaussians, layers: list[Layers]
) -> None:
    visible = visibility_of(red_car, CLASSIC, layers, symmetric=True)
    found, shown = visible.shares, visible.shown
    assert found.fault(len(red_car)) is None
    torch.testing.assert_close(found.columns.sum(dim=1), torch.ones(len(red_car)))
    left, right = (way * red_car.means[:, 1] > 0.6 for way in (1, -1))
    assert bool(shown.any()) and not bool(shown[found.invented > 0.99].any())
    height = red_car.means[:, 2]  # of the floor, and not of sills and wheels
    under = (height < height.quantile(0.2)) & (red_car.means[:, 1].abs() < 0.4)
    seen, mirrored = found.seen, found.mirrored
    assert float(seen[left].mean()) > 5 * float(seen[right].mean())
    assert float(mirrored[right].mean()) > 5 * float(mirrored[left].mean())
    assert float(found.invented[under].mean()) > float(found.invented[left].mean())
    alone = visibility_of(red_car, CLASSIC, layers, symmetric=False).shares
    assert not bool(alone.mirrored.any())
    room = visible.freedom(red_car)
    assert float(room[left].mean()) > float(room[right].mean()) > float(room[under].mean())


def test_untrusted_pixels_show_nothing(red_car: Gaussians, layers: list[Layers]) -> None:
    blind = [dataclasses.replace(view, trust=torch.zeros_like(view.trust)) for view in layers]
    found = visibility_of(red_car, CLASSIC, blind, symmetric=True).shares
    torch.testing.assert_close(found.invented, torch.ones(len(red_car)))


def row_of(colours: list[float]) -> Gaussians:
    """Grey discs in a row across, on their side."""
    count = len(colours)
    sh = torch.tensor(colours)[:, None, None].expand(count, 4, 3).clone()
    sh[:, 0] = (sh[:, 0] - 0.5) / C0
    sh[:, 1:] = 0
    means = torch.zeros(count, 3)
    means[:, 1] = torch.linspace(-0.5, 0.5, count)
    return Gaussians(
        means,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.tensor([[-3.0, -3.0, -6.0]]).repeat(count, 1),
        torch.full((count,), 4.0),
        sh,
    )


def test_invented_paint_follows_seen_paint() -> None:
    """Forty light discs were seen darker than made; a light one nobody saw follows, glass not."""
    prior = row_of([0.8] * 41 + [0.1])
    refined = row_of([0.6] * 40 + [0.8, 0.1])
    seen = torch.ones(42)
    seen[40:] = 0
    made = follow_paint(prior, refined, Shares(seen, torch.zeros(42)))
    colours = 0.5 + C0 * made.sh[:, 0, 0]
    # 32 lenders against two lenders' worth of doubt
    assert float(colours[40]) == pytest.approx(0.8 - 0.2 * 32 / 34, abs=0.005)
    assert float(colours[41]) == pytest.approx(0.1, abs=1e-4)
    torch.testing.assert_close(made.sh[:40], refined.sh[:40])


def test_without_anything_seen_paint_stays() -> None:
    prior = row_of([0.8, 0.3])
    nobody = Shares(torch.zeros(2), torch.zeros(2))
    assert follow_paint(prior, prior, nobody) is prior
