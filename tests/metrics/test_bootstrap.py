"""The cluster bootstrap."""

import numpy as np
import pytest

from recast.metrics import cluster_bootstrap, exact_bootstrap


def test_sampling_approaches_the_exact_distribution():
    scenes = np.random.default_rng(1).normal(size=(7, 4))
    sampled = cluster_bootstrap(scenes, np.random.default_rng(0))
    exact = exact_bootstrap(scenes)
    assert sampled.point == exact.point == pytest.approx(scenes.mean())
    for name in ("low", "high", "mean", "std"):
        assert getattr(sampled, name) == pytest.approx(getattr(exact, name), abs=0.01)


def test_unequal_scenes_weigh_by_their_pairs():
    scenes = [[1.0, 1.0, 1.0], [0.0]]
    exact = exact_bootstrap(scenes)
    assert exact.point == 0.75
    # multisets: both first (1), both second (0), one of each (3 of 4), half the time
    assert exact.mean == pytest.approx(0.25 * 1 + 0.5 * 0.75)
    assert (exact.low, exact.high) == (0.0, 1.0)


def test_equal_differences_have_no_spread():
    sampled = cluster_bootstrap([[0.25] * 3] * 5, np.random.default_rng(0), samples=1000)
    assert (sampled.low, sampled.high, sampled.std) == (0.25, 0.25, 0.0)


def test_rollouts_of_a_scene_stay_together():
    """Opposite differences within each scene cancel: drawing rollouts singly would spread."""
    assert cluster_bootstrap([[1.0, -1.0]] * 6, np.random.default_rng(0), 1000).std == 0.0


def test_a_wider_level_is_wider():
    scenes = np.random.default_rng(2).normal(size=(6, 2))
    narrow, wide = exact_bootstrap(scenes, 0.5), exact_bootstrap(scenes, 0.95)
    assert wide.low < narrow.low < narrow.high < wide.high


@pytest.mark.parametrize("scenes", [[], [[1.0], []]])
def test_no_data_is_refused(scenes):
    with pytest.raises(ValueError, match="pair"):
        cluster_bootstrap(scenes, np.random.default_rng(0))


def test_too_many_scenes_to_enumerate_are_refused():
    with pytest.raises(ValueError, match="enumerate"):
        exact_bootstrap(np.zeros((14, 1)))
