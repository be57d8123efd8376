"""The training loss: sub-scores of every trajectory, and which one the human drove."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import torch
from torch import Tensor
from torch.nn import functional

from recast.planning.gtrs.head import IMITATION

METRIC_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "no_at_fault_collisions": 3.0,
        "drivable_area_compliance": 3.0,
        "time_to_collision_within_bound": 4.0,
        "ego_progress": 2.0,
        "driving_direction_compliance": 1.0,
        "lane_keeping": 2.0,
        "traffic_light_compliance": 3.0,
    }
)
"""Weights of the binary cross-entropies in the released training."""

HALF_COUNTS_AS_ZERO = ("no_at_fault_collisions", "driving_direction_compliance")
"""Sub-scores of 0, 0.5 or 1 of which the heads learn only whether they are 1."""

DEMONSTRATED = slice(4, 40, 5)
"""Indices of the eight waypoints, 0.5 s .. 4 s, that are compared with the human's."""

_SOFTNESS = 0.5


def training_loss(
    logits: Mapping[str, Tensor],
    targets: Mapping[str, Tensor],
    trajectories: Tensor,
    demonstration: Tensor,
    metric_weights: Mapping[str, float] = METRIC_WEIGHTS,
) -> dict[str, Tensor]:
    """The weighted terms of the loss, scalars by head; their sum is minimised.

    Metric heads: mean binary cross-entropy against the sub-scores; targets may be soft, as
    progress is. Imitation: cross-entropy against softmax over L of the negative squared distance,
    in metres and radians over eight poses, to the human's trajectory, divided by 0.5.

    Args:
        logits: head name to (B, L).
        targets: metric name to sub-scores (B, L) in [0, 1] of the trajectories as a controller
            would drive them; names without a weight are ignored.
        trajectories: (L, 40, 3) or (B, L, 40, 3), those that were scored.
        demonstration: (B, 8, 3) the human's poses at 0.5 s .. 4 s in the present ego frame.
        metric_weights: a metric that is left out is not trained.

    Source: the released training of GTRS (Li et al. 2025).
    """
    terms = {}
    for name, weight in metric_weights.items():
        target = targets[name].to(logits[name].dtype)
        if name in HALF_COUNTS_AS_ZERO:
            target = (target > 0.5).to(target.dtype)
        terms[name] = weight * functional.binary_cross_entropy_with_logits(logits[name], target)
    distance = (trajectories[..., DEMONSTRATED, :] - demonstration[:, None]).square().sum((-2, -1))
    likeness = torch.softmax(-distance / _SOFTNESS, dim=-1)
    terms[IMITATION] = functional.cross_entropy(
        logits[IMITATION], likeness.to(logits[IMITATION].dtype)
    )
    return terms


def vocabulary_dropout(size: int, kept: int, generator: torch.Generator) -> Tensor:
    """Indices (kept,) of a random part of the vocabulary, to be scored in one training step.

    The released training keeps 8192 of 16384; trajectories and targets are indexed alike.

    Args:
        size: of the whole vocabulary.
        kept: at most `size`.
        generator: source of all random numbers.

    Raises:
        ValueError: `kept` is not in 1 .. `size`.
    """
    if not 1 <= kept <= size:
        raise ValueError(f"vocabulary_dropout: kept must be in 1 .. {size}, got {kept}")
    return torch.randperm(size, generator=generator, device=generator.device)[:kept]
