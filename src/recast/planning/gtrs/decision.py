"""What the planner thought: a score for every trajectory, not only the best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.planning.types import Candidates

Float32Array = NDArray[np.float32]


@dataclass(frozen=True)
class GtrsDecision:
    """Scores of all trajectories at one moment.

    Attributes:
        trajectories: (N, 40, 3) x, y, heading of the rear axle in the present ego frame; the
            vocabulary, and behind it the external proposals, where there were any.
        scores: (N,) log scores, see `final_score`.
        sub_scores: by head, (N,): expected sub-scores in [0, 1]; of "imi", the probability that a
            human drives the trajectory.
        first: index from which on trajectories may be chosen; those before are only scored.
    """

    trajectories: Float32Array
    scores: Float32Array
    sub_scores: Mapping[str, Float32Array]
    first: int = 0

    def order(self) -> NDArray[np.int64]:
        """Indices that may be chosen, best first; equal scores in the vocabulary's order."""
        best: NDArray[np.int64] = np.argsort(-self.scores[self.first :], kind="stable") + self.first
        return best

    @property
    def best(self) -> int:
        """Index of the chosen trajectory."""
        return int(np.argmax(self.scores[self.first :])) + self.first

    def top(self, count: int) -> Candidates:
        """The best trajectories, best first; fewer than `count` where there are no more."""
        chosen = self.order()[:count]
        return Candidates(
            waypoints=self.trajectories[chosen].astype(np.float64),
            scores=self.scores[chosen].astype(np.float64),
        )
