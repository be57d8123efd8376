"""From the heads' logits to one score per trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from pydantic import NonNegativeFloat, PositiveFloat
from torch import Tensor
from torch.nn import functional

from recast.planning.gtrs.head import IMITATION
from recast.records import Record


class ScoreWeights(Record):
    """Weights of the final score; see `final_score`.

    Attributes:
        imitation: of log softmax of the imitation head.
        no_collision, drivable_area, direction, traffic_light: of the log of each sub-score.
        average: of the log of the weighted sum of the three that follow.
        time_to_collision, progress, lane_keeping: within that sum.
    """

    imitation: NonNegativeFloat
    no_collision: NonNegativeFloat
    drivable_area: NonNegativeFloat
    direction: NonNegativeFloat
    traffic_light: NonNegativeFloat
    average: NonNegativeFloat
    time_to_collision: PositiveFloat
    progress: PositiveFloat
    lane_keeping: PositiveFloat


VOCABULARY_ONLY = ScoreWeights(
    imitation=0.03,
    no_collision=0.1,
    drivable_area=0.9,
    direction=0.2,
    traffic_light=0.1,
    average=6.0,
    time_to_collision=7.0,
    progress=7.0,
    lane_keeping=3.0,
)
"""Where only the vocabulary is scored: the released image-only mode."""

COMBINED = ScoreWeights(
    imitation=0.01,
    no_collision=0.5,
    drivable_area=0.5,
    direction=0.5,
    traffic_light=0.1,
    average=3.0,
    time_to_collision=5.0,
    progress=5.0,
    lane_keeping=2.0,
)
"""Where external proposals are scored together with the vocabulary."""


def final_score(logits: Mapping[str, Tensor], weights: ScoreWeights = VOCABULARY_ONLY) -> Tensor:
    """Log score (B, L) of every trajectory; the highest is driven.

    S = w_i log softmax_L(imi) + w_tl log TL + w_nc log NC + w_dac log DAC + w_ddc log DDC
    + w_avg log(w_ttc TTC + w_ep EP + w_lk LK), each sub-score being the sigmoid of its logit.

    Args:
        logits: head name to (B, L).
        weights: `VOCABULARY_ONLY`, or `COMBINED` where L includes external proposals.
    """
    multipliers = {
        "traffic_light_compliance": weights.traffic_light,
        "no_at_fault_collisions": weights.no_collision,
        "drivable_area_compliance": weights.drivable_area,
        "driving_direction_compliance": weights.direction,
    }
    averaged = {
        "time_to_collision_within_bound": weights.time_to_collision,
        "ego_progress": weights.progress,
        "lane_keeping": weights.lane_keeping,
    }
    score = weights.imitation * functional.log_softmax(logits[IMITATION], dim=-1)
    for name, weight in multipliers.items():
        score = score + weight * functional.logsigmoid(logits[name])
    # In logs all the way: a sum of sigmoids of very low logits would round to zero.
    terms = [
        functional.logsigmoid(logits[name]) + math.log(weight) for name, weight in averaged.items()
    ]
    return score + weights.average * torch.logsumexp(torch.stack(terms), dim=0)


def product_score(logits: Mapping[str, Tensor]) -> Tensor:
    """The score in [0, 1] that is usually quoted (B, L): TL NC DAC DDC (5 TTC + 5 EP + 2 LK) / 12.

    It orders trajectories much as the combined mode does, without the imitation term.
    """
    p = {name: value.sigmoid() for name, value in logits.items()}
    average = (
        5 * p["time_to_collision_within_bound"] + 5 * p["ego_progress"] + 2 * p["lane_keeping"]
    ) / 12
    return (
        p["traffic_light_compliance"] * p["no_at_fault_collisions"]
        * p["drivable_area_compliance"] * p["driving_direction_compliance"] * average
    )  # fmt: skip


def combined_trajectories(vocabulary: Tensor, proposals: Tensor) -> Tensor:
    """(L, 40, 3) and external proposals (B, N, 40, 3) as one set (B, L + N, 40, 3) to be scored."""
    shared = vocabulary.expand(len(proposals), -1, -1, -1)
    return torch.cat([shared, proposals.to(vocabulary)], dim=1)
