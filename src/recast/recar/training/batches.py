"""Which vehicles a step sees, and which of its parts takes each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def draw_identities(
    identities: Sequence[str], count: int, rng: np.random.Generator
) -> tuple[str, ...]:
    """Draw the vehicles of a batch: no one twice before all were drawn once."""
    drawn: list[str] = []
    while len(drawn) < count:
        order = rng.permutation(len(identities))[: count - len(drawn)]
        drawn += [identities[i] for i in order]
    return tuple(drawn)


def balanced_parts(loads: Sequence[int], parts: int) -> list[list[int]]:
    """Split a batch into parts of about the same load, such as voxels.

    The heaviest sample first, each goes to the part with the least load so far (Graham 1969,
    longest processing time first); no part stays empty.

    Args:
        loads: of each sample, above zero.
        parts: at most as many as samples.

    Returns:
        Indices of the samples of each part, ascending.

    Raises:
        ValueError: more parts than samples.
    """
    if parts > len(loads):
        raise ValueError(f"a batch of {len(loads)} does not split into {parts} parts")
    groups: list[list[int]] = [[] for _ in range(parts)]
    totals = [0] * parts
    for index in sorted(range(len(loads)), key=lambda i: (-loads[i], i)):
        lightest = min(range(parts), key=lambda p: (totals[p], len(groups[p]), p))
        groups[lightest].append(index)
        totals[lightest] += loads[index]
    return [sorted(group) for group in groups]
