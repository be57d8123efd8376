"""The same scenario under two arms: pairs over the steps that both have, or why they are none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from recast.arrays import Array
from recast.evaluation.table import Attempt, Metric, Scored
from recast.simulation.rollout import Rollout

_Key = tuple[str, str | None, str, str]

Rollouts = TypeVar("Rollouts", bound=Scored)


@dataclass(frozen=True)
class Pair:
    """Two rollouts of a scenario, both up to the end of the shorter.

    Attributes:
        candidate, baseline: their metrics up to there.
        plans: how many plans each made up to there.
        cut: whether one of them went on for longer.
    """

    candidate: Mapping[str, Metric]
    baseline: Mapping[str, Metric]
    plans: int
    cut: bool


@dataclass(frozen=True)
class PairedMetric:
    """Candidate minus baseline of one metric, over the pairs in which both have a value.

    Attributes:
        differences: by scene, (n,) plain values; scenes without a pair are left out.
        pairs: number of these pairs.
        plans: how many plans each side made in them.
        cut: how many of the pairs end where one of the two rollouts was cut.
        asked: scenarios that either arm was asked for, failed rollouts among them.
    """

    differences: Mapping[str, Array]
    pairs: int
    plans: int
    cut: int
    asked: int


@dataclass(frozen=True)
class Pairs:
    """All pairs of two arms.

    Attributes:
        by_scene: pairs by name of the scene.
        asked: see `PairedMetric`.
    """

    by_scene: Mapping[str, tuple[Pair, ...]]
    asked: int

    def of(self, metric: str) -> PairedMetric:
        """One metric, a key of `recast.evaluation.table.COLUMNS`."""
        differences: dict[str, Array] = {}
        used: list[Pair] = []
        for scene, pairs in self.by_scene.items():
            values = []
            for pair in pairs:
                one, other = pair.candidate[metric].value, pair.baseline[metric].value
                if one is not None and other is not None:
                    values.append(one - other)
                    used.append(pair)
            if values:
                differences[scene] = np.array(values)
        return PairedMetric(
            differences=differences,
            pairs=len(used),
            plans=sum(pair.plans for pair in used),
            cut=sum(pair.cut for pair in used),
            asked=self.asked,
        )


def matched_pairs(
    scored: Mapping[str, Sequence[Scored]],
    candidate: str,
    baseline: str,
    failed: Mapping[str, Sequence[Attempt]] | None = None,
) -> Pairs:
    """Match rollouts of two arms by planner, track, motion and setting.

    A rollout that was cut had fewer chances to fail than one that was not: each pair is compared
    up to the end of its shorter rollout.

    Args:
        scored: by name of the scene, its rollouts; those of other arms are ignored.
        candidate, baseline: arms.
        failed: rollouts that ended in an error: they have no pair, but were asked for.
    """
    by_scene: dict[str, tuple[Pair, ...]] = {}
    asked: set[tuple[str, _Key]] = set()
    for scene, attempts in (failed or {}).items():
        asked |= {(scene, _key(a)) for a in attempts if a.arm in (candidate, baseline)}
    for scene, rollouts in scored.items():
        found: dict[str, dict[_Key, Scored]] = {candidate: {}, baseline: {}}
        for rollout in rollouts:
            if rollout.arm in found:
                found[rollout.arm][_key(rollout)] = rollout
                asked.add((scene, _key(rollout)))
        shared = [key for key in found[candidate] if key in found[baseline]]
        if shared:
            by_scene[scene] = tuple(
                _pair(found[candidate][key], found[baseline][key]) for key in shared
            )
    return Pairs(by_scene, len(asked))


def over_common_steps(one: Rollouts, other: Rollouts) -> tuple[Rollouts, Rollouts]:
    """Both rollouts up to the end of the shorter."""
    assert one.steps_run is not None and other.steps_run is not None  # both were scored
    steps = min(one.steps_run, other.steps_run)
    return one.over(steps), other.over(steps)


def _pair(candidate: Scored, baseline: Scored) -> Pair:
    one, other = over_common_steps(candidate, baseline)
    return Pair(
        candidate=one.values,
        baseline=other.values,
        plans=min(one.plans, other.plans),
        cut=candidate.steps_run != baseline.steps_run,
    )


def _key(attempt: Attempt) -> _Key:
    return attempt.planner, attempt.track_id, attempt.motion, attempt.setting


def script_difference(one: Rollout, other: Rollout) -> str | None:
    """What differs that no arm may change, in words; None where nothing does.

    The states of scripted actors are compared up to the end of the shorter: where its ego leaves
    the road decides how long a rollout is. Of actors that react only the first state is compared.
    """
    for field in ("track_id", "start_timestamp_us", "dt", "steps_requested", "ego_centre_offset"):
        if getattr(one, field) != getattr(other, field):
            return f"{field} differs: {getattr(one, field)}, not {getattr(other, field)}"
    for field in ("actor_size", "ego_size", "route"):
        if not np.array_equal(getattr(one, field), getattr(other, field)):
            return f"{field} differs"
    if not np.array_equal(one.ego[0], other.ego[0]):
        return "the ego's first state differs"
    ids = [[r.track_id, *(actor.track_id for actor in r.controlled)] for r in (one, other)]
    if ids[0] != ids[1] or one.reactive != other.reactive:
        return "the controlled actors differ"
    for track_id, states, others in zip(ids[0], _states(one), _states(other), strict=True):
        common = 1 if track_id in one.reactive else min(len(states), len(others))
        apart = np.flatnonzero((states[:common] != others[:common]).any(axis=1))
        if len(apart):
            who = "the actor" if track_id == one.track_id else f"actor {track_id}"
            return f"{who}'s states differ from step {apart[0]} on"
    return None


def _states(rollout: Rollout) -> list[np.ndarray]:
    """States and poses (S+1, 20) of each controlled actor, the target first."""
    actors = [(rollout.actor, rollout.world_from_actor)]
    actors += [(actor.states, actor.world_from_actor) for actor in rollout.controlled]
    return [np.hstack([states, poses.reshape(-1, 16)]) for states, poses in actors]
