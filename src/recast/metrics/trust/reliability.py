"""How far a trust figure can be trusted: reliability by bins, ROC curve, Brier score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.metrics.trust.model import RIDGE, TrustModel, fit_model

BINS = 5
"""Bins of equal width from 0 to 1."""


@dataclass(frozen=True)
class JudgedRollout:
    """A rollout whose verdict was compared with the truth.

    Attributes:
        scene: its id; rollouts of one scene are alike.
        scenario: motion and setting of the actor.
        planner, arm: the rollout's fields of the same names, see `Rollout`.
        features: features by name, see `recast.metrics.trust.FEATURES`.
        agrees: whether its verdict is that of the truth.
    """

    scene: str
    scenario: str
    planner: str
    arm: str
    features: Mapping[str, float]
    agrees: bool


@dataclass(frozen=True)
class ReliabilityBin:
    """Rollouts whose trust lies from `low` up to `high`; the last bin includes 1.

    Attributes:
        trust: their mean trust; None without a rollout.
        agreeing: share of them whose verdict is right; None without a rollout.
    """

    low: float
    high: float
    count: int
    trust: float | None
    agreeing: float | None


@dataclass(frozen=True)
class Reliability:
    """How trust and truth go together.

    Attributes:
        auc: area under the ROC curve: the chance that of a right and a wrong verdict the right one
            has the greater trust; None if all are right, or all wrong.
        verdict_auc: the same of a figure that looks at the verdict alone, collision or not.
        brier: mean squared difference between trust and truth (1 right, 0 wrong).
        base_brier: the same of a figure that gives every rollout the share of right verdicts.
    """

    scenes: int
    rollouts: int
    agreeing: int
    auc: float | None
    verdict_auc: float | None
    brier: float
    base_brier: float
    bins: tuple[ReliabilityBin, ...]


def area_under_roc(trust: ArrayLike, agrees: ArrayLike) -> float | None:
    """Area under the ROC curve of N rollouts, equal ones counted half; see `Reliability.auc`.

    Args:
        trust: (N,) trust in each rollout, 0 to 1.
        agrees: (N,) bool, whether each verdict is right.
    """
    given, right = np.asarray(trust, np.float64), np.asarray(agrees, np.bool_)
    good, bad = given[right], np.sort(given[~right])
    if len(good) == 0 or len(bad) == 0:
        return None
    below = np.searchsorted(bad, good, "left") + np.searchsorted(bad, good, "right")
    return float(below.mean() / (2 * len(bad)))


def reliability(rollouts: Sequence[JudgedRollout], trust: ArrayLike) -> Reliability:
    """Compare the trust (N,) of N rollouts, at least one, with the truth."""
    given = np.asarray(trust, np.float64)
    right = np.array([one.agrees for one in rollouts], np.bool_)
    edges = np.linspace(0.0, 1.0, BINS + 1)
    place = np.minimum((given * BINS).astype(np.int64), BINS - 1)
    bins = []
    for i in range(BINS):
        inside = place == i
        known = bool(inside.any())
        bins.append(
            ReliabilityBin(
                float(edges[i]),
                float(edges[i + 1]),
                int(inside.sum()),
                float(given[inside].mean()) if known else None,
                float(right[inside].mean()) if known else None,
            )
        )
    share = float(right.mean())
    alone = area_under_roc([one.features["collision"] for one in rollouts], right)
    return Reliability(
        scenes=len({one.scene for one in rollouts}),
        rollouts=len(rollouts),
        agreeing=int(right.sum()),
        auc=area_under_roc(given, right),
        verdict_auc=None if alone is None else max(alone, 1.0 - alone),
        brier=float(np.mean((given - right) ** 2)),
        base_brier=share * (1 - share),
        bins=tuple(bins),
    )


def trust_left_out(rollouts: Sequence[JudgedRollout], ridge: float = RIDGE) -> Array:
    """Trust (N,) of each rollout by a model that was fitted without any rollout of its scene.

    Raises:
        ValueError: fewer than two scenes.
    """
    scenes = dict.fromkeys(one.scene for one in rollouts)
    if len(scenes) < 2:
        raise ValueError(f"trust_left_out: {len(scenes)} scenes, expected at least 2")
    found = np.zeros(len(rollouts))
    for scene in scenes:
        model = fit_rollouts([one for one in rollouts if one.scene != scene], ridge)
        for i, one in enumerate(rollouts):
            if one.scene == scene:
                found[i] = model.trust(one.features)
    return found


def fit_rollouts(rollouts: Sequence[JudgedRollout], ridge: float = RIDGE) -> TrustModel:
    """The model of some rollouts; see `fit_model`."""
    return fit_model([one.features for one in rollouts], [one.agrees for one in rollouts], ridge)
