"""The moments of a scenario at which its arms part, or end differently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from recast.metrics.collision import CAP
from recast.reporting.inputs import NotMade, RolloutPart
from recast.reporting.plots import first_true, planned_paths, series
from recast.reporting.summary import listed
from recast.simulation.rollout import Rollout

PATHS_APART = 0.5
"""Metres between the egos of two arms from which on their paths count as parted."""
PLANS_APART = 1.0
"""Metres between two plans of the same step, at the same waypoint, from which on they differ."""


@dataclass(frozen=True)
class Moment:
    """A moment of a scenario: step of the rollouts, seconds from their start, why it is shown."""

    step: int
    time: float
    reasons: tuple[str, ...]


def find_moments(parts: Sequence[RolloutPart], arms: Mapping[str, str]) -> tuple[Moment, ...]:
    """Moments of one scenario, by time.

    These are the first step at which two arms' plans, and two arms' ego positions, are more than
    `PLANS_APART` and `PATHS_APART` apart; the first contact; the first departure from the road; and
    the plan with the least time to collision of those made before its arm's first contact, if that
    time is below 4 s. If there is none of these, it is the moment of the smallest gap. Reasons at
    the same step are one moment.

    Args:
        parts: rollouts of the scenario; those that did not come about are left out.
    """
    driven = {part.arm: part for part in parts if isinstance(part.rollout, Rollout)}
    if not driven:
        return ()
    rollouts = {arm: p.rollout for arm, p in driven.items() if isinstance(p.rollout, Rollout)}
    found = [
        *_earliest("the plans diverge", _plans_part(rollouts), arms),
        *_earliest("the paths diverge", _paths_part(rollouts), arms),
        *_first("contact", {arm: _contact(part) for arm, part in driven.items()}, arms),
        *_first("off the road", {arm: _off(part) for arm, part in driven.items()}, arms),
        *_worst_plan(driven, arms),
    ]
    if not found:
        found = _smallest_gap(rollouts, arms)
    dt = next(iter(rollouts.values())).dt
    reasons: dict[int, list[str]] = {}
    for step, words in found:
        reasons.setdefault(step, []).append(words)
    return tuple(
        Moment(step, round(step * dt, 6), tuple(reasons[step])) for step in sorted(reasons)
    )


_Found = list[tuple[int, str]]
"""Steps, and why each is a moment."""


def paths_part(one: Rollout, other: Rollout) -> int | None:
    """First step at which two egos are more than `PATHS_APART` apart; None if they never are."""
    steps = min(len(one.ego), len(other.ego))
    away = np.hypot(*(one.ego[:steps, :2] - other.ego[:steps, :2]).T)
    return first_true(away > PATHS_APART)


def _paths_part(rollouts: Mapping[str, Rollout]) -> dict[tuple[str, str], int]:
    pairs = combinations(rollouts, 2)
    steps = {(one, other): paths_part(rollouts[one], rollouts[other]) for one, other in pairs}
    return {pair: step for pair, step in steps.items() if step is not None}


def _plans_part(rollouts: Mapping[str, Rollout]) -> dict[tuple[str, str], int]:
    firsts = {}
    paths = {arm: planned_paths(rollout) for arm, rollout in rollouts.items()}
    for (one, first), (other, second) in combinations(rollouts.items(), 2):
        shared = min(len(first.plan_steps), len(second.plan_steps))
        same = first.plan_steps[:shared] == second.plan_steps[:shared]
        away = np.linalg.norm(paths[one][:shared] - paths[other][:shared], axis=-1).max(axis=1)
        beyond = first_true(same & (away > PLANS_APART))
        if beyond is not None:
            firsts[one, other] = int(first.plan_steps[beyond])
    return firsts


def _earliest(words: str, firsts: Mapping[tuple[str, str], int], arms: Mapping[str, str]) -> _Found:
    if not firsts:
        return []
    one, other = min(firsts, key=lambda pair: firsts[pair])
    return [(firsts[one, other], f"{words}: {arms[one]} and {arms[other]}")]


def _first(words: str, steps: Mapping[str, int | None], arms: Mapping[str, str]) -> _Found:
    known = {arm: step for arm, step in steps.items() if step is not None}
    if not known:
        return []
    first = min(known.values())
    titles = [arms[arm] for arm, step in known.items() if step == first]
    return [(first, f"{words}: {listed(titles)}")]


def _contact(part: RolloutPart) -> int | None:
    assert isinstance(part.rollout, Rollout)
    if isinstance(part.metrics, NotMade):
        return series(part.rollout).collision_step
    return part.metrics.collision.first_step


def _off(part: RolloutPart) -> int | None:
    return None if isinstance(part.metrics, NotMade) else part.metrics.drivable.first_step


def _worst_plan(parts: Mapping[str, RolloutPart], arms: Mapping[str, str]) -> _Found:
    worst: tuple[float, int, str] | None = None
    for arm, part in parts.items():
        if isinstance(part.metrics, NotMade):
            continue
        hit = _contact(part)
        before = len([step for step in part.metrics.plan_steps if hit is None or step < hit])
        times = part.metrics.ttc.per_cycle[:before]
        if len(times) == 0:
            continue
        plan = int(np.argmin(times))
        if times[plan] < CAP and (worst is None or times[plan] < worst[0]):
            worst = float(times[plan]), part.metrics.plan_steps[plan], arms[arm]
    if worst is None:
        return []
    return [(worst[1], f"worst plan, meets the actor after {worst[0]:.1f} s: {worst[2]}")]


def _smallest_gap(rollouts: Mapping[str, Rollout], arms: Mapping[str, str]) -> _Found:
    gaps = {arm: series(rollout).gap for arm, rollout in rollouts.items()}
    arm = min(gaps, key=lambda key: float(gaps[key].min()))
    return [(int(np.argmin(gaps[arm])), f"smallest gap, {gaps[arm].min():.1f} m: {arms[arm]}")]
