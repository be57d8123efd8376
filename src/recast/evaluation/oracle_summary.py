"""Means of the comparison with the oracle, by how far a view is from any logged one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from recast.evaluation.bootstrap import Bootstrap, cluster_bootstrap
from recast.evaluation.oracle_scores import Agreement

MEASURES = ("psnr", "ssim", "mask_iou")
"""Fields of `Agreement`; higher is better for all."""

EDGES = ((0.0, 30.0), (30.0, 60.0), (60.0, 90.0), (90.0, 180.0), (60.0, 180.0), (0.0, 180.0))
"""Degrees from the nearest logged view, the lower end included: four bins, then "beyond 60" and
all views."""

SAMPLES = 20_000


class ScoredView(Protocol):
    """What a summary needs of a view."""

    @property
    def heading(self) -> float:
        """Radians."""

    @property
    def angle(self) -> float:
        """Degrees."""

    @property
    def baseline(self) -> Agreement:
        """Score of the baseline actor."""

    @property
    def candidate(self) -> Agreement:
        """Score of the candidate actor."""


@dataclass(frozen=True)
class AngleBin:
    """The views within a range of angles.

    Attributes:
        low, high: degrees from the nearest logged view, [low, high).
        views: how many.
        baseline, candidate: means over them; None where there is none.
        difference: by measure, candidate minus baseline of the same view: mean and interval,
            headings drawn with replacement with all their views. Empty where there is no view.
        candidate_better: by measure, in how many views the candidate actor is the better one.
    """

    low: float
    high: float
    views: int
    baseline: Agreement | None
    candidate: Agreement | None
    difference: Mapping[str, Bootstrap]
    candidate_better: Mapping[str, int]


def summarise(views: Sequence[ScoredView], rng: np.random.Generator) -> tuple[AngleBin, ...]:
    """One `AngleBin` for each of `EDGES`."""
    return tuple(
        _bin(
            [v for v in views if low <= v.angle < high or v.angle == high == 180.0], low, high, rng
        )
        for low, high in EDGES
    )


def _bin(
    views: Sequence[ScoredView], low: float, high: float, rng: np.random.Generator
) -> AngleBin:
    difference, better = {}, {}
    for measure in MEASURES:
        by_heading: dict[float, list[float]] = {}
        for view in views:
            change = getattr(view.candidate, measure) - getattr(view.baseline, measure)
            by_heading.setdefault(round(view.heading, 6), []).append(change)
        if by_heading:
            difference[measure] = cluster_bootstrap(list(by_heading.values()), rng, SAMPLES)
        better[measure] = sum(bool(change > 0) for group in by_heading.values() for change in group)
    return AngleBin(
        low=low,
        high=high,
        views=len(views),
        baseline=_mean([view.baseline for view in views]),
        candidate=_mean([view.candidate for view in views]),
        difference=difference,
        candidate_better=better,
    )


def _mean(scores: Sequence[Agreement]) -> Agreement | None:
    if not scores:
        return None
    return Agreement(*(float(np.mean([getattr(s, m) for s in scores])) for m in MEASURES))
