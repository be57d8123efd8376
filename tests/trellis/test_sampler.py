"""The Euler sampler against flows whose solution is known."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.trellis.sampler import (
    Condition,
    SamplerSettings,
    StepRecord,
    Velocity,
    noise_scale,
    sample,
    time_steps,
)

SIGMA = 1e-5
TOKENS = Condition(torch.zeros(1, 1, 2, 3))
UNGUIDED = SamplerSettings(cfg_strength=0.0)


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def point_mass(data: Tensor) -> Velocity:
    """Exact velocity of the flow whose data is one point: eps is known from x_t."""

    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        u = (t / 1000).view(-1, *[1] * (x.ndim - 1))
        eps = (x - (1 - u) * data) / (SIGMA + (1 - SIGMA) * u)
        return (1 - SIGMA) * eps - data

    return velocity


def of_condition(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
    """Constant velocity: the sample's first token number."""
    return cond[:, 0, 0].view(-1, *[1] * (x.ndim - 1)).expand_as(x)


@pytest.mark.parametrize("steps", [1, 2, 7, 25])
def test_a_point_mass_is_reached_exactly(steps: int) -> None:
    data, start = noise(2, 3, 4, 4, 4, seed=1), noise(2, 3, 4, 4, 4)
    records: list[StepRecord] = []

    found = sample(
        point_mass(data), start, TOKENS, UNGUIDED.merged(steps=steps), on_step=records.append
    )

    torch.testing.assert_close(found, data + SIGMA * start, atol=3e-6, rtol=0)
    for record in records:  # every step of a straight path points at the same data
        found = (1 - SIGMA) * record.before - noise_scale(record.t, SIGMA) * record.velocity
        torch.testing.assert_close(found, data, atol=2e-5, rtol=0)


def test_the_error_of_a_gaussian_halves_with_twice_the_steps() -> None:
    # For x_0 ~ N(1, 0.5^2) and sigma = 0 the flow maps eps to 1 + 0.5 eps.
    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        u = float(t[0]) / 1000
        variance = (1 - u) ** 2 * 0.25 + u**2
        slope = (u - (1 - u) * 0.25) / variance
        return slope * (x - (1 - u)) - 1.0

    start = torch.linspace(-2, 2, 9, dtype=torch.float64)[:, None]
    errors = [
        float(
            (
                sample(
                    velocity,
                    start,
                    TOKENS,
                    SamplerSettings(steps=steps, cfg_strength=0.0, rescale_t=1.0, sigma_min=0.0),
                )
                - (1 + 0.5 * start)
            )
            .abs()
            .max()
        )
        for steps in (40, 80, 160)
    ]

    assert errors[0] < 0.05
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize("interval", [(0.0, 1.0), (0.5, 1.0), (0.2, 0.6), (0.0, 0.0)])
def test_guidance_weighs_the_condition_by_one_plus_its_strength(
    interval: tuple[float, float],
) -> None:
    settings = SamplerSettings(steps=10, cfg_strength=3.0, cfg_interval=interval)
    times = time_steps(settings)
    inside = sum(t - after for t, after in pairwise(times) if interval[0] <= t <= interval[1])
    start = noise(1, 2)

    found = sample(of_condition, start, Condition(torch.full((1, 1, 2, 3), 0.5)), settings)

    # The velocity without condition is zero, so the guided one is 4 * 0.5.
    expected = start - (2.0 * inside + 0.5 * (1 - inside))
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)


def test_the_network_runs_twice_only_where_guidance_acts() -> None:
    calls: list[tuple[float, bool]] = []

    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        calls.append((float(t[0]), bool((cond == 0).all())))
        assert cond.shape == (2, 4, 3)
        return torch.zeros_like(x)

    condition = Condition(torch.ones(1, 1, 4, 3))
    sample(velocity, noise(2, 5), condition, SamplerSettings())
    assert len(calls) == 44
    assert sum(negative for _, negative in calls) == 19
    assert calls[0] == (1000.0, False)

    calls.clear()
    sample(velocity, noise(2, 5), condition, UNGUIDED)
    assert len(calls) == 25


def test_sparse_noise_has_times_per_sample_not_per_row() -> None:
    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        assert (t.shape, cond.shape, x.shape) == ((3,), (3, 2, 3), (11, 4))
        assert t.dtype == torch.float32
        return torch.zeros_like(x)

    sample(velocity, noise(11, 4), TOKENS, SamplerSettings(steps=2), samples=3)


def test_each_sample_follows_its_own_condition() -> None:
    tokens = torch.tensor([1.0, 2.0, 3.0])[None, :, None, None].expand(1, 3, 2, 3)
    start = noise(3, 4)

    found = sample(of_condition, start, Condition(tokens), UNGUIDED)

    torch.testing.assert_close(found, start - torch.tensor([[1.0], [2.0], [3.0]]))


def test_no_graph_is_kept_and_the_noise_is_left_alone() -> None:
    weight = torch.ones(1, requires_grad=True)
    start = noise(1, 3)
    before = start.clone()

    found = sample(lambda x, t, c: weight * x, start, TOKENS, UNGUIDED)

    assert not found.requires_grad
    assert torch.equal(start, before)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_velocity_that_is_not_finite_stops_the_run_and_names_the_step(bad: float) -> None:
    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        return torch.full_like(x, bad if float(t[0]) < 800 else 0.0)

    with pytest.raises(InputError, match=r"step 4 of 6 \(t = 0\.75\): the velocity is not finite"):
        sample(velocity, noise(1, 3), TOKENS, UNGUIDED.merged(steps=6))


def test_a_velocity_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="velocity"):
        sample(lambda x, t, c: x[:, :1], noise(1, 3), TOKENS, UNGUIDED)


def test_round_robin_uses_one_view_a_step_and_guides_with_it() -> None:
    views = torch.tensor([1.0, 10.0, 100.0]).view(3, 1, 1, 1)
    settings = SamplerSettings(steps=5, cfg_strength=1.0, cfg_interval=(0.5, 1.0))
    records: list[StepRecord] = []

    sample(of_condition, noise(2, 3), Condition(views), settings, on_step=records.append)

    assert [record.views for record in records] == [(0,), (1,), (2,), (0,), (1,)]
    assert [float(r.velocity[0, 0]) for r in records] == [
        value * (2 if record.guided else 1)
        for value, record in zip([1, 10, 100, 1, 10], records, strict=True)
    ]


def test_multidiffusion_averages_the_views_and_needs_one_negative() -> None:
    seen: list[float] = []

    def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        seen.append(float(cond[0, 0, 0]))
        return of_condition(x, t, cond) + 7.0

    condition = Condition(torch.tensor([1.0, 2.0, 6.0]).view(3, 1, 1, 1), "multidiffusion")
    records: list[StepRecord] = []
    settings = SamplerSettings(steps=1, cfg_strength=2.0)
    sample(velocity, noise(1, 3), condition, settings, on_step=records.append)

    assert seen == [1.0, 2.0, 6.0, 0.0]
    # 3 * (3 + 7) - 2 * 7
    torch.testing.assert_close(records[0].velocity, torch.full((1, 3), 16.0))


def test_more_views_than_steps_is_said() -> None:
    views = Condition(torch.zeros(3, 1, 1, 1))

    with pytest.warns(RuntimeWarning, match="3 views but 2 sampling steps"):
        sample(of_condition, noise(1, 3), views, SamplerSettings(steps=2))


def test_conditions_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="expected"):
        Condition(torch.zeros(1, 2, 3))
    with pytest.raises(ValueError, match="expected"):
        Condition(torch.zeros(0, 1, 2, 3))
    with pytest.raises(ValueError, match="mode"):
        Condition(torch.zeros(1, 1, 2, 3), "random")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="2 samples, expected 3"):
        sample(of_condition, noise(3, 4), Condition(torch.zeros(1, 2, 2, 3)), UNGUIDED)
