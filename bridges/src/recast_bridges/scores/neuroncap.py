"""NeuroNCAP's score: five stars without a collision, else by how much of the speed was lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.dynamics import state as ego
from recast.metrics.rollout_metrics import rollout_actors, rollout_collisions
from recast.metrics.table import Metric, invalid
from recast.simulation.rollout import Rollout

Reference = Literal["four-seconds", "log-end"]
"""When the recorded ego's speed is taken: 4 s after the start, as NeuroNCAP's protocol says; or at
the end of the recording, as its code does."""

_BEST, _BEST_HIT = 5.0, 4.0
_NOMINAL = 4.0
"""Seconds after the start at which an ego that does not react would hit."""
_STANDS = 0.1
"""m/s of reference speed below which the share of it that was lost is that of the noise of poses: a
centimetre in the 0.1 s of a step."""
_LAST = 0.5
"""Seconds at the end of the recording whose mean speed `log-end` takes."""


@dataclass(frozen=True)
class NcapScore:
    """NeuroNCAP's score of a rollout.

    Attributes:
        score: 0 to 5 stars; no value after a collision with a reference speed below 0.1 m/s.
        impact_speed: m/s of the ego against the actor at the first contact, or None without one.
        reference_speed: m/s of the recorded ego against the target, without any reaction.
    """

    score: Metric
    impact_speed: float | None
    reference_speed: float

    @property
    def collides(self) -> bool:
        """Whether the ego touches a controlled actor."""
        return self.impact_speed is not None

    def to_json(self) -> dict[str, Any]:
        """Plain values by name."""
        speeds = {"impact_speed": self.impact_speed, "reference_speed": self.reference_speed}
        return {**self.score.to_json(), **speeds, "any_collide": self.collides}


def neuroncap_score(rollout: Rollout, reference: Reference = "four-seconds") -> NcapScore:
    """5 without a collision, else 4 max(0, 1 - impact speed / reference speed).

    Both speeds are lengths of the difference of two velocities. Boxes are the rollout's:
    NeuroNCAP's ego is 4.018 m by 1.85 m. In rollouts that end before 4 s, their last step stands
    for the time without a reaction.
    """
    dt, steps = rollout.dt, rollout.steps_run
    nominal = min(round(_NOMINAL / dt), steps - 1)
    first = max(0, steps - max(1, round(_LAST / dt))) if reference == "log-end" else nominal
    last = steps if reference == "log-end" else nominal + 1
    unhindered = _velocity(rollout.log_ego, first, last, dt)
    target = _velocity(rollout.actor, nominal, nominal + 1, dt)
    reference_speed = float(np.hypot(*(unhindered - target)))

    found = rollout_collisions(rollout)
    hits = {key: one.first_step for key, one in found.items() if one.first_step is not None}
    if not hits:
        return NcapScore(Metric(_BEST), None, reference_speed)
    key = min(hits, key=lambda one: hits[one])
    step = hits[key]
    actor = next(one for one in rollout_actors(rollout) if one.track_id == key)
    before = max(0, step - 1)
    heading, speed = rollout.ego[step, ego.HEADING], rollout.ego[step, ego.VX]
    own = speed * np.array([np.cos(heading), np.sin(heading)])
    impact = float(np.hypot(*(own - _velocity(actor.states, before, before + 1, dt))))
    if reference_speed < _STANDS:
        score = invalid(
            "the reference speed is 0: without a reaction, the ego would not approach the actor"
        )
    else:
        value = _BEST_HIT * max(0.0, 1.0 - impact / reference_speed)
        reason = f"hits {actor.name} at step {step} at {impact:.1f} m/s"
        reason += f" (reference {reference_speed:.1f} m/s)"
        score = Metric(value, reason)
    return NcapScore(score, impact, reference_speed)


def neuroncap_mean(scores: Mapping[str, Mapping[str, Sequence[float]]]) -> float:
    """NeuroNCAP's average: over the runs of a sequence, then over sequences, then categories.

    Args:
        scores: scores of each run, by category and sequence; none empty.
    """
    return float(np.mean([np.mean([np.mean(r) for r in one.values()]) for one in scores.values()]))


def _velocity(path: ArrayLike, first: int, last: int, dt: float) -> Array:
    """Mean velocity (2,) in m/s of positions (S+1, >=2) between two steps."""
    position = np.asarray(path, np.float64)[:, :2]
    return np.asarray((position[last] - position[first]) / ((last - first) * dt))
