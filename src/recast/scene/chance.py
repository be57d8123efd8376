"""Random choices of a run: they hang on seed and step alone, so a resumed run repeats them."""

from __future__ import annotations

import numpy as np
import torch

FLIPS, DEFORMATION = 1, 2
"""Streams of what a step sees mirrored, and of the first weights of the deformation network;
density control has the one without a number."""


def generator(seed: int, iteration: int, *stream: int) -> torch.Generator:
    """Random numbers of one step, others for every `stream`."""
    words = np.random.SeedSequence([seed, iteration, *stream]).generate_state(1)
    return torch.Generator().manual_seed(int(words[0]))


def picked_view(seed: int, iteration: int, count: int) -> int:
    """The view of a step: each epoch visits every one of `count` once, in an order of its own."""
    epoch, position = divmod(iteration, count)
    return int(np.random.default_rng([seed, epoch]).permutation(count)[position])
