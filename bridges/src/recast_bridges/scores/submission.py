"""Plans submitted for NAVSIM's scenes, each scored in its scene, with the human filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.errors import InputError
from recast_bridges.scores.epdms import (
    PlanScore,
    PlanSituation,
    human_filtered,
    planned_poses,
    score_human,
    score_plan,
)


@dataclass(frozen=True)
class SubmittedScene:
    """One scene for which plans are submitted.

    Attributes:
        token: its id.
        synthetic: whether the scene belongs to the second stage.
        start_s: seconds at which the plan begins, on the log's clock.
        situation: what the plan is judged in.
        human: (N, 3) what the human drove, as `score_plan`'s waypoints at 0.1 s; None for none. It
            filters the scores of original scenes.
    """

    token: str
    synthetic: bool
    start_s: float
    situation: PlanSituation
    human: Array | None = None


@dataclass(frozen=True)
class TokenScore:
    """What the plan of one token scored.

    Attributes:
        token, synthetic, start_s: the scene's fields of the same names, see `SubmittedScene`.
        start, endpoint: (2,) world x, y of the rear axle now, and where the plan itself ends.
        plan: its scores, filtered; None if there is no valid plan.
        reason: why there is none.
    """

    token: str
    synthetic: bool
    start_s: float
    start: Array
    endpoint: Array
    plan: PlanScore | None
    reason: str | None = None


def score_scene(
    scene: SubmittedScene, waypoints: ArrayLike | None, interval: float = 0.5
) -> TokenScore:
    """Score the plan submitted for a scene; one that cannot be scored is failed, not an error.

    Args:
        waypoints: waypoints of the plan, as for `score_plan`; None where nothing was submitted.
        interval: seconds between waypoints, as for `score_plan`.
    """
    start = scene.situation.state[:2]
    failed = TokenScore(
        scene.token, scene.synthetic, scene.start_s, start, np.full(2, np.nan), None
    )
    if waypoints is None:
        return replace(failed, reason="no plan was submitted")
    try:
        plan = score_plan(scene.situation, waypoints, interval)
        if scene.human is not None and not scene.synthetic:
            human = score_human(scene.situation, scene.human)
            plan = replace(plan, scores=human_filtered(plan.scores, human.scores))
    except (InputError, ValueError) as error:
        return replace(failed, reason=str(error))
    end = planned_poses(scene.situation, waypoints, interval)[-1, :2]
    return replace(failed, endpoint=end, plan=plan)
