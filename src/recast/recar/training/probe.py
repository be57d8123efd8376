"""Does the flow look at the picture: its loss with true and with exchanged conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from recast.recar.training.flow_task import FlowTask
from recast.recar.training.tokens import ConditionTokens, View

_SEED = 20_260


class ConditionGap:
    """Losses of fixed held-out vehicles, always at the same times and with the same noise.

    A flow that ignores its picture has the same loss when every vehicle is given that of another:
    a gap of zero. Small flows fall into that for good, so it is watched from the start.

    Args:
        task: whose flow is measured.
        tokens: of held-out pictures.
        identities: at least two.
    """

    def __init__(self, task: FlowTask, tokens: ConditionTokens, identities: Sequence[str]) -> None:
        rng = np.random.default_rng(_SEED)
        self._task = task
        self._tokens = tokens
        self._targets = [task.targets.target(one) for one in identities]
        self._views = [View(one, int(rng.integers(tokens.source.count(one)))) for one in identities]

    @torch.no_grad()
    def __call__(self) -> dict[str, float]:
        """`held_out` (loss), `shuffled` (loss with exchanged pictures) and `gap` between them."""
        clean = [None] * len(self._views)
        cond = self._tokens.of(self._views, clean, np.random.default_rng(_SEED))
        losses = []
        for tokens in (cond, cond.roll(1, dims=0)):
            generator = torch.Generator().manual_seed(_SEED)
            losses.append(float(self._task.flow_loss(self._targets, tokens, generator).loss))
        true, shuffled = losses
        return {"held_out": true, "shuffled": shuffled, "gap": shuffled - true}
