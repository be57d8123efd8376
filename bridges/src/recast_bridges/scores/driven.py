"""The EPDMS of every plan of a closed-loop rollout: NAVSIM's definitions, not NAVSIM's table."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from recast.arrays import Array
from recast.core.errors import InputError
from recast.dynamics import PACIFICA, VehicleParameters
from recast.geometry import Polyline
from recast.logs.hdmap import HdMap
from recast.metrics.driving import any_collision, realised_future
from recast.metrics.rollout_metrics import rollout_actors, rollout_collisions
from recast.metrics.table import Metric, invalid
from recast.planning.map import PlannerMap, continued_route, planner_map, route_blocks
from recast.planning.pdm import ExtendedScores, Obstacle, extended_comfort
from recast.planning.pdm.scorer import LONGEST_INTERVAL, STEPS
from recast.planning.types import ActorState, ReferenceRoute
from recast.simulation.rollout import Rollout
from recast_bridges.scores.two_stage import PlanScore, PlanSituation, score_plan

_DT = 0.1
_HISTORY = 15
"""States in front of a plan for HC: 1.5 s."""
_BEYOND = 120.0
"""Metres of route beyond the log's end, as for PDM-Closed as a planner."""


@dataclass(frozen=True)
class DrivenEpdms:
    """EPDMS of the plans of a rollout.

    Attributes:
        mean: mean over the plans; no value where PDM-Closed cannot plan or steps are not 0.1 s.
        per_plan: (C,) EPDMS; of 14 where a plan has none to be compared with, else of 16.
        scores: sub-metrics (C,).
        extended_comfort: (C,) EC of each plan and the one before, of the first one and the second;
            NaN where there is none within 0.55 s.
    """

    mean: Metric
    per_plan: Array
    scores: ExtendedScores
    extended_comfort: Array

    def to_json(self) -> dict[str, Any]:
        """Plain values by name; the sub-metrics as means over plans."""
        compared = self.extended_comfort[~np.isnan(self.extended_comfort)]
        means = {
            one.name: float(np.mean(getattr(self.scores, one.name)))
            for one in fields(self.scores)
            if len(self.per_plan)
        }
        if len(compared):
            means["extended_comfort"] = float(compared.mean())
        return {**self.mean.to_json(), "means": means, "per_plan": self.per_plan.tolist()}


def driven_epdms(
    rollout: Rollout, hd_map: HdMap | None, vehicle: VehicleParameters = PACIFICA
) -> DrivenEpdms:
    """Score each plan of a rollout by NAVSIM v2's rules, from the state in which it was made.

    Road users are the controlled actors, as for the headline metrics; they go on as they did in
    the rollout, and after its end at constant velocity. Plans after a first contact count, too,
    though they begin in it: NAVSIM has no such plans, since each of its scenes is one plan from a
    recorded state. `Metric.reason` says how many they are. The history of HC is what the ego drove
    in the rollout, up to 1.5 s. There are no traffic lights in logs: TLC is 1.

    Args:
        hd_map: map of the log, with lanes.
        vehicle: gives the wheelbase; the outline is the rollout's.
    """
    if hd_map is None or not hd_map.lanes:
        return _none("no lanes in the map")
    if abs(rollout.dt - _DT) > 1e-9:
        return _none(
            f"NAVSIM's rules need steps of {_DT} s, but the drive has steps of {rollout.dt:g} s"
        )
    if len(rollout.plan_steps) == 0:
        return _none("no plan was made")
    half, offset = rollout.ego_size[0] / 2, rollout.ego_centre_offset
    vehicle = replace(
        vehicle,
        width=float(rollout.ego_size[1]),
        front_length=float(half + offset),
        rear_length=float(half - offset),
    )
    try:
        lanes = planner_map(hd_map)
        line = Polyline.from_points(rollout.route)
        headings = np.unwrap(line.heading(line.arc_lengths))
        path = ReferenceRoute(line, headings, np.zeros(len(line.points)))
        route = continued_route(lanes, route_blocks(lanes, path), _BEYOND)
        plans = [
            score_plan(_situation(rollout, int(step), lanes, route, vehicle), waypoints)
            for step, waypoints in zip(rollout.plan_steps, rollout.predictions, strict=True)
        ]
    except InputError as error:
        return _none(str(error))
    compared = _extended_comforts(plans, np.diff(rollout.plan_steps) * _DT)
    scores = ExtendedScores(
        *(np.array([getattr(p.scores, f.name) for p in plans]) for f in fields(ExtendedScores))
    )
    alone = np.isnan(compared)
    totals = np.where(alone, scores.total(), scores.total(np.where(alone, 0.0, compared)))
    worst = int(np.argmin(totals))
    reason = f"lowest score {totals[worst]:.2f} at step {int(rollout.plan_steps[worst])}"
    contact = any_collision(list(rollout_collisions(rollout).values())).first_step
    later = 0 if contact is None else int(np.count_nonzero(rollout.plan_steps > contact))
    if later:
        reason += f"; {later} of {len(totals)} plans were made after the contact at step {contact}"
    mean = float(totals.mean())
    return DrivenEpdms(Metric(mean, reason if mean < 1.0 else None), totals, scores, compared)


def _situation(
    rollout: Rollout,
    step: int,
    lanes: PlannerMap,
    route: tuple[str, ...],
    vehicle: VehicleParameters,
) -> PlanSituation:
    actors = rollout_actors(rollout)
    paths = np.stack([realised_future(one.states, [step], _DT, STEPS + 1)[0] for one in actors])
    moved = (paths[:, 1] - paths[:, 0])[:, :2] / _DT
    obstacles = tuple(
        Obstacle.from_actor(ActorState(one.track_id, one.category, path[0], velocity, one.size))
        for one, path, velocity in zip(actors, paths, moved, strict=True)
    )
    return PlanSituation(
        rollout.ego[step],
        lanes,
        route,
        obstacles,
        lambda states: paths,
        history=rollout.ego[max(0, step - _HISTORY) : step],
        vehicle=vehicle,
    )


def _extended_comforts(plans: list[PlanScore], intervals: Array) -> Array:
    """EC (C,) of each plan and the one before; the first has that of the second."""
    found = np.full(len(plans), np.nan)
    for i, (previous, now) in enumerate(pairwise(plans)):
        if intervals[i] < LONGEST_INTERVAL:
            found[i + 1] = extended_comfort(now.states, previous.states, float(intervals[i]))
    found[:1] = found[1:2] if len(plans) > 1 else np.nan
    return found


def _none(reason: str) -> DrivenEpdms:
    empty = np.zeros(0)
    scores = ExtendedScores(*(empty for _ in fields(ExtendedScores)))
    return DrivenEpdms(invalid(reason), empty, scores, empty)
