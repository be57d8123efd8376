from __future__ import annotations

import pytest
import torch

from recast.reconstruction.densify import rows
from recast.reconstruction.settings import OPTIM
from recast.reconstruction.step import TrainableScene
from recast.scene.actor import coloured, mirrored
from recast.splats import Gaussians, concatenate, rasterize
from support.gaussian_clouds import K, part


def pose(yaw: float, x: float) -> torch.Tensor:
    angle = torch.tensor(yaw)
    matrix = torch.eye(4)
    matrix[0, 0] = matrix[2, 2] = angle.cos()
    matrix[0, 2], matrix[2, 0] = angle.sin(), -angle.sin()
    matrix[0, 3] = x
    return matrix


def loss_of(gaussians: Gaussians) -> torch.Tensor:
    result = rasterize(gaussians, torch.eye(4), K, 48, 32)
    return (result.rgb.square().sum() + result.depth.sum()) / 100


@pytest.fixture
def model() -> TrainableScene:
    return TrainableScene(part(40, 0), {"a": part(10, 1), "b": part(12, 2), "c": part(9, 3)})


def test_gradients_equal_those_of_plain_concatenation(model: TrainableScene) -> None:
    poses = {"a": pose(0.2, 0.1), "c": pose(-0.3, 0.2).requires_grad_()}
    drawn = model.draw(poses)
    loss_of(drawn.gaussians).backward()
    model.take_gradients(drawn)

    leaves = [
        Gaussians(**{k: v.requires_grad_() for k, v in rows(part(n, seed)).items()})
        for n, seed in ((40, 0), (10, 1), (9, 3))
    ]
    plain_pose = pose(-0.3, 0.2).requires_grad_()
    world = concatenate(
        [leaves[0], leaves[1].transformed(pose(0.2, 0.1)), leaves[2].transformed(plain_pose)]
    )
    loss_of(world).backward()
    for name, value in rows(model.background).items():
        assert torch.allclose(value.grad, getattr(leaves[0], name).grad, rtol=1e-4, atol=1e-6)
    for name, value in rows(model.local).items():
        assert torch.allclose(value.grad[:10], getattr(leaves[1], name).grad, rtol=1e-4, atol=1e-6)
        assert (value.grad[10:22] == 0).all()  # "b" is absent
        assert torch.allclose(value.grad[22:], getattr(leaves[2], name).grad, rtol=1e-4, atol=1e-6)
    assert poses["c"].grad is not None and plain_pose.grad is not None
    assert torch.allclose(poses["c"].grad, plain_pose.grad, rtol=1e-3, atol=1e-5)


def test_a_step_moves_visible_rows_within_bounds(model: TrainableScene) -> None:
    before = {k: v.clone() for k, v in rows(model.background).items()}
    drawn = model.draw({})
    result = rasterize(drawn.gaussians, torch.eye(4), K, 48, 32)
    (-result.rgb.sum() * 1e3).backward()
    model.take_gradients(drawn)
    background, local = model.visible(drawn, result.meta)
    assert background.any() and not local.any()
    rates = dict.fromkeys(("means", "quats", "log_scales", "logit_opacities", "sh"), 5.0)
    model.step(background, local, rates)
    assert not torch.equal(model.background.means[background], before["means"][background])
    assert torch.equal(model.background.means[~background], before["means"][~background])
    assert (model.background.log_scales >= OPTIM.min_log_scale).all()
    assert (model.background.sh[background, 0].abs() <= OPTIM.colour_limit + 1e-6).all()
    step = (model.background.sh - before["sh"])[background, 1:].abs().max()
    assert 0.2 < step < 0.3  # a twentieth of the rate
    assert torch.equal(model.draw({}).gaussians.means, model.background.means)  # same memory


def test_actors_come_out_as_they_went_in(model: TrainableScene) -> None:
    assert model.track_ids == ("a", "b", "c")
    assert torch.equal(model.actor("b")[0].means, part(12, 2).means)
    assert model.span("c") == (22, 31) and model.count_rows() == 71


def test_a_scene_without_actors() -> None:
    model = TrainableScene(part(20, 0), {})
    drawn = model.draw({})
    loss_of(drawn.gaussians).backward()
    model.take_gradients(drawn)
    assert model.track_ids == () and len(drawn.gaussians) == 20


def test_colours_over_time_and_mirrored_rows_are_drawn_and_learned() -> None:
    model = TrainableScene(part(5, 0), {"a": part(10, 1), "b": part(12, 2)}, fourier_terms=3)
    with torch.no_grad():
        model.fourier += 0.1
    flipped = torch.arange(22) % 2 == 0
    drawn = model.draw({"b": torch.eye(4)}, {"b": 0.25}, flipped)
    expected = mirrored(coloured(part(12, 2), torch.full((12, 2, 3), 0.1), 0.25), flipped[10:])
    for name, value in rows(expected).items():
        assert torch.allclose(getattr(drawn.gaussians, name)[5:], value, atol=1e-6)
    loss_of(drawn.gaussians).backward()
    model.take_gradients(drawn)
    gradient = model.fourier.grad
    assert gradient is not None and (gradient[:10] == 0).all()
    # sin(2 pi / 4) = 1 and cos(2 pi / 4) = 0 times the constant harmonic's gradient
    assert torch.allclose(gradient[10:, 0], model.local.sh.grad[10:, 0], atol=1e-6)
    assert gradient[10:, 1].abs().max() < 1e-6
    before = model.fourier.detach().clone()
    rates = dict.fromkeys(("means", "quats", "log_scales", "logit_opacities", "sh"), 0.01)
    model.step(torch.ones(5, dtype=torch.bool), torch.ones(22, dtype=torch.bool), rates)
    assert (model.fourier[10:, 0] != before[10:, 0]).any()
    assert torch.equal(model.actor("a")[1], before[:10])
