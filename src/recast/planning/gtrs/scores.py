"""Vocabularies of trajectories from files, one score for each trajectory, and the training loss."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from pydantic import NonNegativeFloat, PositiveFloat
from torch import Tensor
from torch.nn import functional

from recast.arrays import BoolArray
from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.core.records import Record
from recast.core.table_files import read_npy
from recast.dynamics.tracker import comfortable_plans
from recast.planning.types import WAYPOINTS

Trajectories = NDArray[np.float32]

METRICS = (
    "no_at_fault_collisions",
    "drivable_area_compliance",
    "time_to_collision_within_bound",
    "ego_progress",
    "driving_direction_compliance",
    "lane_keeping",
    "traffic_light_compliance",
)
"""Heads whose sigmoid is the expected sub-score of a trajectory."""

IMITATION = "imi"
"""Head whose softmax over the vocabulary is the probability that a human drives a trajectory."""

HEADS = (*METRICS, IMITATION)

_MEND = f"give a .npy file of shape (L, {WAYPOINTS}, 3): x, y, heading every 0.1 s"
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

_SOFTNESS, _DT = 0.5, 0.1


def read_vocabulary(path: str | Path) -> Trajectories:
    """Read trajectories (L, 40, 3) from a `.npy` file, as float32.

    Each is x, y, heading of the rear axle in the present ego frame, metres and radians, at 0.1 s ..
    4 s. No pickle is read.

    Raises:
        InputError: the file is missing, is no array of numbers, or `check_vocabulary` refuses it.
    """
    path = Path(path)
    return check_vocabulary(path, read_npy(path, _MEND))


def check_vocabulary(where: str | Path, array: NDArray[np.generic] | Tensor) -> Trajectories:
    """A copy of `array` as a vocabulary, float32; `where` is the file, for the message.

    Raises:
        InputError: it is not (L, 40, 3) with L at least 1, holds no floating-point numbers, or NaN
            or infinite ones.
    """
    shape = tuple(array.shape)
    if len(shape) != 3 or shape[1:] != (WAYPOINTS, 3) or shape[0] == 0:
        raise InputError(where, "vocabulary", f"has shape {shape}", _MEND)
    if isinstance(array, Tensor):
        if not array.is_floating_point():
            raise InputError(where, "vocabulary", f"holds {array.dtype}, not numbers", _MEND)
        array = array.detach().to(torch.float64).numpy()
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(where, "vocabulary", f"holds {array.dtype}, not numbers", _MEND)
    with np.errstate(over="ignore"):  # becomes infinite, which is refused
        trajectories = np.array(array, np.float32)
    bad = np.flatnonzero(~np.isfinite(trajectories).all(axis=(1, 2)))
    if len(bad):
        raise InputError(
            where,
            "vocabulary",
            f"trajectory {bad[0]} holds NaN or infinity ({len(bad)} of {len(trajectories)} do)",
            _MEND,
        )
    return trajectories


def write_vocabulary(path: str | Path, trajectories: Trajectories) -> None:
    """Write trajectories (L, 40, 3) as `.npy`, float32, whole or not at all."""
    with atomic_file(path) as partial, partial.open("wb") as file:
        np.save(file, check_vocabulary(path, trajectories), allow_pickle=False)


class ScoreWeights(Record):
    """Weights of the final score; see `final_score`.

    Attributes:
        imitation: weight of log softmax of the imitation head.
        no_collision, drivable_area, direction, traffic_light: weight of the log of each sub-score.
        average: weight of the log of the weighted sum of the three that follow.
        time_to_collision, progress, lane_keeping: weights within that sum.
        comfort: weight, within that sum too, of trajectories that are `comfortable`; 0 in the
            released modes.
        blended: metres; what is driven is the mean, weighted by exp S, of the trajectories that end
            nearer than this to the best along the road, and than a quarter of it beside. 0: the
            best itself, as in the released modes. Only for trajectories that begin alike, see
            `MotionPrimitives`: there the next best is so near that a grey level may decide between
            two, and the mean hardly moves. Between braking and going on it brakes a little. If the
            best is comfortable, what is not is left out.
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
    comfort: NonNegativeFloat = 0.0
    blended: NonNegativeFloat = 0.0


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


_SMOOTH, _FIRST = 1.5, 9
"""m/s^2, and waypoint; see `comfortable`."""


def comfortable(trajectories: ArrayLike, status: ArrayLike) -> BoolArray:
    """Which trajectories (..., L, 40, 3) are comfortable to plan and to follow: (..., L).

    As plans they pass the five checks of COM. Followed, what jolts is their beginning: a tracker
    brings the ego at once to about the mean acceleration of the first second. Where that is 1.5
    m/s^2 off the present one at most, at every plan 0.5 s apart, nuPlan's smoothed longitudinal
    jerk stays within its 4.13 m/s^3; 0.9 of the trajectories are judged as `com_driven` judges what
    the LQR tracker makes of them.

    Args:
        status: (..., 8), see `ego_status`.
    """
    plans, state = np.asarray(trajectories, np.float64), np.asarray(status, np.float64)
    around = plans[..., _FIRST : _FIRST + 2, :2] - plans[..., _FIRST - 1 : _FIRST + 1, :2]
    later = np.linalg.norm(around, axis=-1).mean(axis=-1) / _DT
    change = later - state[..., None, 4] - _DT * (_FIRST + 1) * state[..., None, 6]
    return comfortable_plans(plans) & (np.abs(change) <= _SMOOTH)


def final_score(
    logits: Mapping[str, Tensor],
    weights: ScoreWeights = VOCABULARY_ONLY,
    calm: Tensor | None = None,
) -> Tensor:
    """Log score (B, L) of every trajectory; the highest is driven.

    S = w_i log softmax_L(imi) + w_tl log TL + w_nc log NC + w_dac log DAC + w_ddc log DDC
    + w_avg log(w_ttc TTC + w_ep EP + w_lk LK + w_c C), each sub-score being the sigmoid of its
    logit. C is known: it depends on the trajectory alone.

    Args:
        logits: head name to (B, L).
        weights: `VOCABULARY_ONLY`, or `COMBINED` where L includes external proposals.
        calm: (L,) or (B, L) bool, C, see `comfortable`; used if `weights.comfort` is above 0.

    Raises:
        ValueError: `weights.comfort` is above 0 and `calm` is not given.
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
    if weights.comfort > 0:
        if calm is None:
            raise ValueError("final_score: weights with comfort need `calm`")
        comfort = calm.to(terms[0]).log() + math.log(weights.comfort)
        terms.append(comfort.expand_as(terms[0]))
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
        p["traffic_light_compliance"]
        * p["no_at_fault_collisions"]
        * p["drivable_area_compliance"]
        * p["driving_direction_compliance"]
        * average
    )


def combined_trajectories(vocabulary: Tensor, proposals: Tensor) -> Tensor:
    """(L, 40, 3) and external proposals (B, N, 40, 3) as one set (B, L + N, 40, 3) to be scored."""
    shared = vocabulary.expand(len(proposals), -1, -1, -1)
    return torch.cat([shared, proposals.to(vocabulary)], dim=1)


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
        trajectories: (L, 40, 3) or (B, L, 40, 3) trajectories that were scored.
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
        kept: number of indices to keep, at most `size`.

    Raises:
        ValueError: `kept` is not in 1 .. `size`.
    """
    if not 1 <= kept <= size:
        raise ValueError(f"vocabulary_dropout: kept must be in 1 .. {size}, got {kept}")
    return torch.randperm(size, generator=generator, device=generator.device)[:kept]
