from __future__ import annotations

import pytest
import torch

from recast.scene.trainable import COLOUR_LIMIT, MIN_LOG_SCALE, TrainableScene, rows
from recast.splats import Gaussians, concatenate, rasterize

K = torch.tensor([[40.0, 0.0, 24.0], [0.0, 40.0, 16.0], [0.0, 0.0, 1.0]])


def part(n: int, seed: int) -> Gaussians:
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Gaussians(
        means=random(n, 3) * 0.5 + torch.tensor([0.0, 0.0, 4.0]),
        quats=random(n, 4),
        log_scales=random(n, 3) * 0.3 - 2,
        logit_opacities=random(n),
        sh=random(n, 4, 3) * 0.3,
    )


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
    assert (model.background.log_scales >= MIN_LOG_SCALE).all()
    assert (model.background.sh[background, 0].abs() <= COLOUR_LIMIT + 1e-6).all()
    step = (model.background.sh - before["sh"])[background, 1:].abs().max()
    assert 0.2 < step < 0.3  # a twentieth of the rate
    assert torch.equal(model.draw({}).gaussians.means, model.background.means)  # same memory


def test_actors_come_out_as_they_went_in(model: TrainableScene) -> None:
    actors = model.actors()
    assert list(actors) == ["a", "b", "c"]
    assert torch.equal(actors["b"].means, part(12, 2).means)
    assert model.span("c") == (22, 31) and model.count_rows() == 71


def test_a_scene_without_actors() -> None:
    model = TrainableScene(part(20, 0), {})
    drawn = model.draw({})
    loss_of(drawn.gaussians).backward()
    model.take_gradients(drawn)
    assert model.actors() == {} and len(drawn.gaussians) == 20
