"""The Frechet distance against its formula, and where the formula's usual root fails."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from recast.metrics.frechet import (
    FeatureStats,
    frechet_between,
    frechet_bootstrap,
    frechet_distance,
)


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


def rounding(first: np.ndarray, second: np.ndarray) -> float:
    """The bound that `frechet_between` states, with room for the eigenproblem's own constant."""
    traces = np.trace(np.cov(first, rowvar=False)) * np.trace(np.cov(second, rowvar=False))
    return 4 * first.shape[1] * float(np.sqrt(np.finfo(float).eps * traces))


@given(st.integers(0, 10_000), st.integers(2, 40), st.integers(2, 60), st.integers(2, 60))
@settings(max_examples=60, deadline=None)
def test_statistics_are_enough(seed: int, dimensions: int, count: int, other: int) -> None:
    """Any number of pictures, fewer or more than dimensions."""
    rng = np.random.default_rng(seed)
    first = 5 + rng.normal(size=(count, dimensions)) @ rng.normal(size=(dimensions, dimensions))
    second = rng.normal(0.5, 2.0, size=(other, dimensions))
    expected = frechet_distance(first, second)
    stats = FeatureStats.of(first), FeatureStats.of(second)
    bound = rounding(first, second)
    assert frechet_between(*stats) == pytest.approx(expected, abs=bound)
    assert frechet_between(*stats[::-1]) == pytest.approx(expected, abs=bound)
    assert frechet_between(stats[0], stats[0]) == pytest.approx(0.0, abs=rounding(first, first))


@given(st.integers(0, 10_000), st.lists(st.integers(0, 3), min_size=3, max_size=3))
@settings(max_examples=30, deadline=None)
def test_statistics_merge_as_their_pictures_do(seed: int, times: list[int]) -> None:
    rng = np.random.default_rng(seed)
    groups = [1e3 + rng.normal(rng.normal(), size=(n, 4)) for n in (1, 7, 12)] + [np.empty((0, 4))]
    stats = [FeatureStats.of(one) for one in groups]
    if not any(times):
        with pytest.raises(ValueError, match="there are no images"):
            FeatureStats.merged(stats, [*times, 1])
        return
    rows = np.concatenate(
        [one for one, many in zip(groups, times, strict=False) for _ in range(many)]
    )
    expected, found = FeatureStats.of(rows), FeatureStats.merged(stats, [*times, 1])
    assert found.count == expected.count
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-13)
    np.testing.assert_allclose(found.scatter, expected.scatter, rtol=1e-9, atol=1e-9)


def test_constant_features_of_low_rank() -> None:
    constant = FeatureStats.of(np.ones((6, 30)))
    assert frechet_between(constant, FeatureStats.of(np.full((4, 30), 1.5))) == pytest.approx(7.5)
    with pytest.raises(ValueError, match="1 and 6 images, expected at least 2"):
        frechet_between(FeatureStats.of(np.ones((1, 30))), constant)


@pytest.mark.parametrize("counts", [(3, 2), (30, 9)])
def test_the_bootstrap_redraws_pictures(counts: tuple[int, int]) -> None:
    """Against `frechet_distance` of the features of the drawn scenes; both sets drawn together."""
    rng = np.random.default_rng(3)
    scenes = [f"scene-{index}" for index in (10, 2, 1, 0)]  # not in order
    first, second = (
        {
            scene: rng.normal(rng.normal(), 1.0, size=(count + index, 16))
            for index, scene in enumerate(scenes)
        }
        for count in counts
    )
    stats = [
        {scene: FeatureStats.of(rows) for scene, rows in one.items()} for one in (first, second)
    ]
    draws = rng.integers(0, 4, (40, 4))
    found = frechet_bootstrap(*stats, draws)
    names = sorted(scenes)
    for draw, distance in zip(draws, found, strict=True):
        drawn = [np.concatenate([one[names[i]] for i in draw]) for one in (first, second)]
        assert distance == pytest.approx(frechet_distance(*drawn), abs=rounding(*drawn))
    assert np.array_equal(found[7:], frechet_bootstrap(*stats, draws[7:]))  # workers may share them
    assert np.ptp(found) > 0.1
    same = np.array([frechet_bootstrap(stats[0], stats[0], draws)])
    assert same.max() == pytest.approx(0.0, abs=rounding(*drawn))
    del stats[0]["scene-2"]
    with pytest.raises(ValueError, match="frechet_bootstrap: scenes"):
        frechet_bootstrap(*stats, draws)
