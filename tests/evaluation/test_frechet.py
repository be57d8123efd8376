"""The Frechet distance against its formula, and where the formula's usual root fails."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from recast.evaluation.frechet import frechet_distance


def by_the_formula(first: np.ndarray, second: np.ndarray) -> float:
    covariances = [np.cov(one, rowvar=False) for one in (first, second)]
    apart = first.mean(axis=0) - second.mean(axis=0)
    root = sqrtm(covariances[0] @ covariances[1]).real
    return float(apart @ apart + np.trace(covariances[0] + covariances[1] - 2 * root))


@given(st.integers(0, 10_000), st.integers(2, 5), st.integers(12, 40))
@settings(max_examples=30, deadline=None)
def test_by_the_formula(seed: int, dimensions: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.normal(size=(count, dimensions)) @ rng.normal(size=(dimensions, dimensions))
    second = rng.normal(0.5, 2.0, size=(count + 7, dimensions))
    expected = by_the_formula(first, second)
    assert frechet_distance(first, second) == pytest.approx(expected, rel=1e-7, abs=1e-7)
    assert frechet_distance(second, first) == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_gaussians_of_one_dimension() -> None:
    """(m1 - m2)^2 + (s1 - s2)^2."""
    first = np.array([[1.0], [3.0]])  # mean 2, deviation sqrt 2
    second = np.array([[5.0], [13.0]])  # mean 9, deviation sqrt 32
    assert frechet_distance(first, second) == pytest.approx(49 + (32**0.5 - 2**0.5) ** 2)


def test_fewer_pictures_than_dimensions() -> None:
    """Covariances of low rank, as of 2048 features of a few hundred pictures."""
    rng = np.random.default_rng(1)
    narrow = rng.normal(size=(9, 4))
    other = rng.normal(1.0, 3.0, size=(9, 4))
    turn = np.linalg.qr(rng.normal(size=(300, 4)))[0].T  # keeps distances
    expected = by_the_formula(narrow, other)
    assert frechet_distance(narrow @ turn, other @ turn) == pytest.approx(expected, rel=1e-9)
    assert frechet_distance(narrow @ turn, narrow @ turn) == pytest.approx(0.0, abs=1e-12)
    constant = np.ones((6, 300))
    assert frechet_distance(constant, constant + 0.1) == pytest.approx(3.0)


def test_few_pictures_make_it_too_large() -> None:
    rng = np.random.default_rng(2)

    def mean_distance(count: int) -> float:
        pairs = [(rng.normal(size=(count, 16)), rng.normal(size=(count, 16))) for _ in range(20)]
        return float(np.mean([frechet_distance(a, b) for a, b in pairs]))

    few, many = mean_distance(20), mean_distance(200)
    assert few > 5 * many > 0  # the truth is 0


def test_what_is_refused() -> None:
    good = np.zeros((3, 4))
    for bad in (np.zeros((1, 4)), np.zeros((3, 5)), np.zeros(4)):
        with pytest.raises(ValueError, match="frechet_distance"):
            frechet_distance(good, bad)
