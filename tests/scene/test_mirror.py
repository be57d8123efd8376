from __future__ import annotations

import torch

from recast.scene.actor import mirrored, with_other_side
from recast.splats import Gaussians, rasterize
from recast.splats.gaussians import quat_to_matrix
from support.gaussian_clouds import K, part


def car() -> Gaussians:
    """Degree 3, around the origin of a box frame (x forward, y left, z up)."""
    g = part(30, 5)
    sh = 0.2 * torch.randn(30, 16, 3, generator=torch.Generator().manual_seed(6))
    centre = torch.tensor([0.0, 0.0, 4.0])
    return Gaussians(g.means - centre, g.quats, g.log_scales, g.logit_opacities, sh)


def from_behind(lateral: float) -> torch.Tensor:
    """camera_from_box of a camera 4 m behind, `lateral` to the left, looking forward."""
    pose = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 4], [0, 0, 0, 1]])
    pose[0, 3] = lateral
    return pose


def test_a_mirrored_car_is_seen_from_the_other_side_as_a_mirror_image() -> None:
    own, other = car(), mirrored(car(), torch.ones(30, dtype=torch.bool))
    here = rasterize(own, from_behind(0.7), K, 48, 32).rgb
    there = rasterize(other, from_behind(-0.7), K, 48, 32).rgb
    assert here.max() > 0.5
    assert torch.allclose(there.flip(1), here, atol=2e-4)


def test_covariances_are_those_of_the_reflection() -> None:
    def covariance(g: Gaussians) -> torch.Tensor:
        axes = quat_to_matrix(torch.nn.functional.normalize(g.quats, dim=1))
        axes = axes * g.log_scales.exp()[:, None]
        return axes @ axes.transpose(1, 2)

    flip = torch.diag(torch.tensor([1.0, -1.0, 1.0]))
    other = mirrored(car(), torch.ones(30, dtype=torch.bool))
    assert torch.allclose(covariance(other), flip @ covariance(car()) @ flip, atol=1e-6)


def test_only_chosen_rows_move_and_twice_is_not_at_all() -> None:
    chosen = torch.arange(30) % 3 == 0
    once = mirrored(car(), chosen)
    assert torch.equal(once.means[~chosen], car().means[~chosen])
    assert torch.equal(once.sh[~chosen], car().sh[~chosen])
    twice = mirrored(once, chosen)
    assert torch.allclose(twice.means, car().means) and torch.allclose(twice.sh, car().sh)
    assert torch.allclose(twice.quats[chosen], -car().quats[chosen])  # the same rotation


def test_gradients_come_back_mirrored() -> None:
    g = car()
    means = g.means.clone().requires_grad_()
    moved = Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh)
    chosen = torch.arange(30) < 10
    mirrored(moved, chosen).means.sum().backward()
    assert means.grad is not None
    assert (means.grad[:10, 1] == -1).all() and (means.grad[10:, 1] == 1).all()


def test_the_fuller_side_is_doubled() -> None:
    g = car()
    g.means[:, 1] = torch.where(torch.arange(30) < 20, 0.5, -0.5)
    both = with_other_side(g)
    assert len(both) == 50
    assert torch.equal(both.means[30:, 0], g.means[:20, 0]) and (both.means[30:, 1] == -0.5).all()
