"""A head for the training alone: reads off the image tokens what the picture tells."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.planning.gtrs_training.store import CLUES

_SCALES = (1.0, 12.0, 3.0, 1.0, 1.0, 0.4, 0.06, 0.6, 1.5, 3.0)
"""Usual sizes of the clues."""


class ClueReader(nn.Module):
    """One learned query looks over the image tokens; an MLP names the clues.

    The scores of trajectories depend on the picture only where something is in the way. This loss
    teaches the backbone from the first step on where the vehicle and the road are.

    Args:
        channels: of the tokens.
        generator: of the first weights.
    """

    scales: Tensor

    def __init__(self, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        self.weigh = nn.Linear(channels, 4)
        self.read = nn.Sequential(
            nn.Linear(4 * channels, channels), nn.ReLU(), nn.Linear(channels, len(CLUES))
        )
        self.register_buffer("scales", torch.tensor(_SCALES), persistent=False)
        with torch.no_grad():
            for part in self.modules():
                if isinstance(part, nn.Linear):
                    nn.init.xavier_uniform_(part.weight, generator=generator)
                    nn.init.zeros_(part.bias)

    def forward(self, tokens: Tensor) -> Tensor:
        """Image tokens (B, T, d) to clues (B, 10), in units of `scales`; the first is a logit."""
        weights = self.weigh(tokens).softmax(dim=1)
        pooled = torch.einsum("btq,btd->bqd", weights, tokens).flatten(1)
        out: Tensor = self.read(pooled)
        return out

    def loss(self, found: Tensor, clues: Tensor) -> Tensor:
        """Presence by cross-entropy; the vehicle's place where it is there; the road always."""
        present = clues[:, 0]
        wanted = clues / self.scales
        misses = functional.smooth_l1_loss(found, wanted, reduction="none")
        vehicle = (misses[:, 1:5].mean(dim=1) * present).sum() / present.sum().clamp(min=1.0)
        seen = functional.binary_cross_entropy_with_logits(found[:, 0], present)
        return seen + 2.0 * vehicle + misses[:, 5:].mean()
