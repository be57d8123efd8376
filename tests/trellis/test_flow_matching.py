"""The objective: path, target, loss, times and dropped conditions."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from recast.trellis.sampler import FlowMatching, drop_condition, sample_timesteps, time_bins


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_target_is_the_time_derivative_of_the_path() -> None:
    flow = FlowMatching(sigma_min=0.1)
    x0, noise = torch.randn(2, 3, 5, generator=generator()).double()
    early, late = torch.full((3,), 0.25).double(), torch.full((3,), 0.75).double()

    slope = (flow.interpolate(x0, noise, late) - flow.interpolate(x0, noise, early)) / 0.5

    torch.testing.assert_close(slope, flow.target(x0, noise))


def test_the_path_runs_from_data_to_noise() -> None:
    flow = FlowMatching(sigma_min=0.1)
    x0, noise = torch.randn(2, 3, 5, generator=generator())

    torch.testing.assert_close(flow.interpolate(x0, noise, torch.zeros(3)), x0 + 0.1 * noise)
    torch.testing.assert_close(flow.interpolate(x0, noise, torch.ones(3)), noise)


BATCH = torch.tensor([0, 0, 0, 2])  # the sample in the middle has no rows


def test_sparse_rows_take_the_time_of_their_sample() -> None:
    x0, noise, t = torch.ones(4, 2), torch.zeros(4, 2), torch.tensor([0.25, 0.5, 1.0])

    x_t = FlowMatching().interpolate(x0, noise, t, BATCH)

    assert x_t[:, 0].tolist() == [0.75, 0.75, 0.75, 0.0]


def test_the_sparse_loss_is_the_mean_over_rows_and_logs_are_per_sample() -> None:
    seen: list[Tensor] = []

    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        seen.append(t)
        return torch.tensor([[1.0], [1.0], [1.0], [5.0]]).expand(4, 2)

    x0, t = torch.zeros(4, 2), torch.tensor([0.05, 0.5, 0.98])
    loss = FlowMatching().loss(velocity, x0, torch.zeros(3, 1, 1), t, x0, BATCH)

    assert float(loss.loss) == pytest.approx((3 * 1 + 25) / 4)  # not (1 + 25) / 2
    torch.testing.assert_close(seen[0], 1000 * t)
    assert loss.per_sample[0] == 1
    assert math.isnan(loss.per_sample[1])
    assert loss.per_sample[2] == 25
    assert loss.bins[0] == 1
    assert loss.bins[9] == 25
    assert loss.bins[1:9].isnan().all()


def test_the_dense_loss_is_the_mean_over_elements_and_has_gradients() -> None:
    weight = torch.tensor(2.0, requires_grad=True)
    x0 = torch.zeros(2, 3, 2, 2, 2)
    noise = torch.randn(x0.shape, generator=generator())

    loss = FlowMatching().loss(
        lambda x, t, c: weight * torch.ones_like(x), x0, torch.zeros(2, 1, 1), torch.rand(2), noise
    )
    loss.loss.backward()

    residual = 2.0 - (1 - 1e-5) * noise
    torch.testing.assert_close(loss.loss.detach(), residual.square().mean())
    torch.testing.assert_close(loss.per_sample, residual.square().flatten(1).mean(1))
    assert weight.grad is not None
    torch.testing.assert_close(weight.grad, 2 * residual.mean())
    assert not loss.per_sample.requires_grad


def test_the_expected_velocity_minimises_the_loss() -> None:
    # For x_0 ~ N(0, 1) and eps ~ N(0, 1): E[eps - x_0 | x_t] = (2t - 1) / ((1-t)^2 + t^2) x_t.
    x0, noise = torch.randn(2, 20_000, 1, generator=generator())
    t = torch.full((20_000,), 0.8)
    best = (2 * 0.8 - 1) / (0.2**2 + 0.8**2)

    def loss(slope: float) -> float:
        cond = torch.zeros(1, 1, 1)
        return float(FlowMatching().loss(lambda x, t, c: slope * x, x0, cond, t, noise).loss)

    assert loss(best) < min(loss(best - 0.1), loss(best + 0.1))


def test_shapes_that_do_not_fit_are_refused() -> None:
    flow, x0, t, cond = FlowMatching(), torch.zeros(2, 3), torch.zeros(2), torch.zeros(2, 1, 1)
    with pytest.raises(ValueError, match="noise"):
        flow.interpolate(x0, torch.zeros(2, 1), t)
    with pytest.raises(ValueError, match="1 times, expected"):
        flow.interpolate(x0, x0, t[:1])  # would broadcast in silence
    with pytest.raises(ValueError, match="velocity"):
        flow.loss(lambda x, t, c: x[:, :1], x0, cond, t, x0)
    with pytest.raises(ValueError, match="the batch is empty"):
        flow.loss(lambda x, t, c: x, x0[:0], cond, t, x0[:0], torch.zeros(0, dtype=torch.int64))


@pytest.mark.parametrize(("mean", "std"), [(1.0, 1.0), (0.5, 0.5)])
def test_times_are_logit_normal(mean: float, std: float) -> None:
    t = sample_timesteps(40_000, generator(), mean, std)
    logit = torch.logit(t.double())

    assert t.dtype == torch.float32
    assert float(t.min()) > 0
    assert float(t.max()) < 1
    assert float(logit.mean()) == pytest.approx(mean, abs=0.02)
    assert float(logit.std()) == pytest.approx(std, abs=0.02)
    third = (logit - mean).pow(3).mean() / std**3
    assert abs(float(third)) < 0.05  # symmetric


def test_randomness_comes_from_the_generator_alone() -> None:
    assert torch.equal(sample_timesteps(5, generator(3)), sample_timesteps(5, generator(3)))
    cond = torch.ones(64, 2, 3)
    first, second = (drop_condition(cond, 0.5, generator(3))[1] for _ in range(2))
    assert torch.equal(first, second)


def test_dropped_conditions_are_zeros_and_the_rest_is_untouched() -> None:
    cond = torch.randn(4000, 2, 3, generator=generator())
    cond[:, 0, 0] = float("inf")  # a product with zero would be NaN

    dropped, mask = drop_condition(cond, 0.1, generator(1))

    assert 0.08 < float(mask.float().mean()) < 0.12
    assert (dropped[mask] == 0).all()
    assert torch.equal(dropped[~mask], cond[~mask])
    assert bool(torch.isinf(cond[:, 0, 0]).all())  # the input is not changed


def test_no_and_every_condition_dropped() -> None:
    cond = torch.ones(50, 1, 1)

    assert not drop_condition(cond, 0.0, generator())[1].any()
    assert drop_condition(cond, 1.0, generator())[1].all()
    with pytest.raises(ValueError, match="probability"):
        drop_condition(cond, 1.5, generator())


def test_time_bins_take_the_mean_of_their_samples() -> None:
    bins = time_bins(torch.tensor([1.0, 3.0, 5.0, 7.0]), torch.tensor([0.0, 0.2, 0.3, 1.0]), 4)

    assert bins[:2].tolist() == [2.0, 5.0]
    assert bool(bins[2].isnan())
    assert float(bins[3]) == 7.0
