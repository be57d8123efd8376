from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recast.recar import split_of


@given(st.text(min_size=1, max_size=20), st.integers(0, 2**40), st.floats(0, 1), st.floats(0, 1))
def test_a_larger_share_only_adds_to_the_held_out(
    name: str, seed: int, first: float, second: float
) -> None:
    small, large = sorted((first, second))
    if split_of(name, seed, small) == "held-out":
        assert split_of(name, seed, large) == "held-out"


def test_the_share_is_kept_and_the_seed_matters() -> None:
    names = [f"vehicle-{i:05d}" for i in range(20000)]
    first = np.array([split_of(name, 0) == "held-out" for name in names])
    second = np.array([split_of(name, 1) == "held-out" for name in names])
    assert abs(first.mean() - 0.05) < 0.005  # 3 standard deviations of 20,000 draws
    assert abs((first & second).mean() - 0.0025) < 0.0012


def test_the_decision_is_the_same_for_ever() -> None:
    # A set on disk keeps its split with every later version: these never change.
    held = [i for i in range(120) if split_of(f"vehicle-{i:05d}", 0) == "held-out"]
    assert held == [26, 39, 47, 53, 65, 75, 101]


def test_small_sets_have_both_parts() -> None:
    for seed in range(50):
        assert split_of("vehicle-00000", seed, index=0) == "train"
        assert split_of("vehicle-00001", seed, index=1) == "held-out"
    assert split_of("a", 0, 0.0, index=1) == "train"
