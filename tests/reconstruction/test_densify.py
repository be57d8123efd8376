from __future__ import annotations

import pytest
import torch

from recast.reconstruction.config import Measure
from recast.reconstruction.densify import GradientStatistics, plan_change
from recast.splats import Gaussians, RasterMeta


def population(n: int = 10) -> Gaussians:
    generator = torch.Generator().manual_seed(0)
    quats = torch.randn(n, 4, generator=generator)
    return Gaussians(
        means=torch.arange(n, dtype=torch.float32)[:, None].repeat(1, 3),
        quats=quats,
        log_scales=torch.full((n, 3), -3.0),
        logit_opacities=torch.zeros(n),
        sh=torch.zeros(n, 4, 3),
    )


def plan(gaussians: Gaussians, gradient: torch.Tensor, **options: object):
    defaults = {"threshold": 1.0, "most_new": 100, "split_above": 0.5, "min_opacity": 0.01}
    generator = torch.Generator().manual_seed(1)
    return plan_change(gaussians, gradient, **{**defaults, **options}, generator=generator)


def test_small_rows_are_cloned_and_large_ones_split() -> None:
    gaussians = population()
    gaussians.log_scales[4] = torch.tensor([0.5, -2.0, -3.0])
    gradient = torch.zeros(10)
    gradient[[2, 4]] = 2.0
    change = plan(gaussians, gradient)
    assert change.parents.tolist() == [2, 4, 4]
    assert change.kept.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert torch.equal(change.born.means[0], gaussians.means[2])
    halves = change.born.means[1:] - gaussians.means[4]
    assert (halves.norm(dim=1) > 0).all() and (halves.norm(dim=1) < 4 * 1.65).all()
    assert torch.allclose(
        change.born.log_scales[1:].exp() * 1.6, gaussians.log_scales[[4, 4]].exp()
    )


def test_splits_are_spread_along_the_parents_axes() -> None:
    n = 2000
    gaussians = population(1).select(torch.zeros(n, dtype=torch.int64))
    gaussians.log_scales[:] = torch.tensor([0.0, -4.0, -4.0])
    gaussians.quats[:] = torch.tensor([2**-0.5, 0.0, 0.0, 2**-0.5])  # a quarter turn about z
    change = plan(gaussians, torch.full((n,), 2.0), most_new=n)
    spread = (change.born.means - gaussians.means[0]).std(dim=0)
    assert abs(spread[1] - 1.0) < 0.1 and spread[0] < 0.05 and spread[2] < 0.05


def test_growth_is_limited_to_the_largest_gradients() -> None:
    gradient = torch.linspace(0.5, 5, 10)
    change = plan(population(), gradient, most_new=2)
    assert change.parents.tolist() == [8, 9]
    assert plan(population(), gradient, most_new=-5).parents.tolist() == []


def test_transparent_and_doomed_rows_go_and_do_not_breed() -> None:
    gaussians = population()
    gaussians.logit_opacities[3] = -8.0
    doomed = torch.zeros(10, dtype=torch.bool)
    doomed[6] = True
    change = plan(gaussians, torch.full((10,), 2.0), doomed=doomed)
    assert 3 not in change.kept and 6 not in change.kept
    assert not set(change.parents.tolist()) & {3, 6}


def test_statistics_average_over_views_that_saw_a_row_in_ndc() -> None:
    statistics = GradientStatistics(2)
    for seen in (True, False):
        meta = RasterMeta(
            visible=torch.tensor([True, seen]),
            radii=torch.ones(2),
            means2d=torch.zeros(2, 2),
            means2d_grad=torch.tensor([[0.3, 0.0], [0.0, 0.4]]),
        )
        statistics.add(meta, slice(0, 2), slice(0, 2), width=20, height=10)
    assert torch.allclose(statistics.mean(), torch.tensor([3.0, 2.0]))


@pytest.mark.parametrize(
    ("measure", "expected"), [("signed", 1.0), ("absolute_norm", 5.0), ("absolute_l1", 7.0)]
)
def test_statistics_take_the_gradient_that_is_named(measure: Measure, expected: float) -> None:
    statistics = GradientStatistics(1)
    meta = RasterMeta(
        visible=torch.tensor([True]),
        radii=torch.ones(1),
        means2d=torch.zeros(1, 2),
        means2d_grad=torch.tensor([[-0.1, 0.0]]),
        means2d_absgrad=torch.tensor([[0.3, 0.8]]),
    )
    statistics.add(meta, slice(0, 1), slice(0, 1), width=20, height=10, measure=measure)
    assert torch.allclose(statistics.mean(), torch.tensor([expected]))
