"""Gradient clipping to a percentile of the latest norms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from recast.training.state import AdaptiveGradClipper


def with_norm(norm: float) -> list[nn.Parameter]:
    """Two parameters whose gradients together have this norm."""
    first, second = nn.Parameter(torch.zeros(1)), nn.Parameter(torch.zeros(2))
    first.grad = torch.tensor([0.6 * norm])
    second.grad = torch.tensor([0.0, 0.8 * norm])
    return [first, second]


def norm_of(parameters: list[nn.Parameter]) -> float:
    return float(torch.cat([p.grad for p in parameters if p.grad is not None]).norm())


def test_before_the_window_is_full_the_bound_is_the_largest_norm() -> None:
    clipper = AdaptiveGradClipper(max_norm=1.0, window=10)
    small, large = with_norm(0.5), with_norm(20.0)

    assert clipper.clip(small) == pytest.approx(0.5)
    assert clipper.clip(large) == pytest.approx(20.0)
    assert norm_of(small) == pytest.approx(0.5)
    assert norm_of(large) == pytest.approx(1.0, rel=1e-5)


def test_then_it_is_the_percentile_of_the_latest_norms_before_clipping() -> None:
    clipper = AdaptiveGradClipper(max_norm=1.0, percentile=95.0, window=20)
    norms = np.random.default_rng(0).uniform(0.1, 0.9, 50)
    for norm in norms:
        clipper.clip(with_norm(float(norm)))

    assert clipper.bound == pytest.approx(np.percentile(norms[-20:], 95), rel=1e-5)
    clipped = with_norm(5.0)
    bound = clipper.bound
    clipper.clip(clipped)
    assert norm_of(clipped) == pytest.approx(bound, rel=1e-5)
    assert clipper.bound > bound  # the norm of 5 was stored, not the clipped one


def test_the_bound_never_exceeds_the_largest_norm() -> None:
    clipper = AdaptiveGradClipper(max_norm=1.0, window=3)
    for _ in range(6):
        clipper.clip(with_norm(8.0))

    assert clipper.bound == 1.0


def test_norms_that_are_not_finite_are_reported_and_not_stored() -> None:
    clipper = AdaptiveGradClipper(window=1)

    assert np.isinf(clipper.clip(with_norm(float("inf"))))
    assert np.isnan(clipper.clip(with_norm(float("nan"))))
    assert clipper.state_dict() == {"norms": []}
    assert clipper.bound == 1.0


def test_a_saved_clipper_continues() -> None:
    clipper, resumed = AdaptiveGradClipper(window=5), AdaptiveGradClipper(window=5)
    for norm in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6):
        clipper.clip(with_norm(norm))
    resumed.load_state_dict(clipper.state_dict())

    assert resumed.bound == clipper.bound < 1
    assert clipper.clip(with_norm(0.9)) == resumed.clip(with_norm(0.9))
    assert resumed.state_dict() == clipper.state_dict()


def test_arguments_out_of_range_are_refused() -> None:
    for arguments in ({"max_norm": 0.0}, {"percentile": 101.0}, {"window": 0}):
        with pytest.raises(ValueError, match="clipper"):
            AdaptiveGradClipper(**arguments)  # type: ignore[arg-type]
