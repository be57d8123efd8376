"""The EPDMS of one plan: against PDM-Closed's plan from the same state, both driven for 4 s."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.dynamics import PACIFICA, VehicleParameters, plan_to_poses, track
from recast.dynamics import state as ego
from recast.dynamics.tracker import PDM_REFERENCE
from recast.planning.map import PlannerMap
from recast.planning.pdm import (
    ExtendedScores,
    Obstacle,
    PdmClosed,
    PdmConfig,
    observed,
    score_extended,
)
from recast.planning.pdm.extended import STEPS

Traffic = Callable[[Array], ArrayLike]
"""Poses (n, 41, 3) of the obstacles' box centres, 0.1 s apart, for the ego's states (41, 11); NaN
while an obstacle is not there."""

_HORIZON = 4.0


@dataclass(frozen=True)
class PlanSituation:
    """What a plan is judged in.

    Attributes:
        state: (11,) state of the ego now.
        planner_map, route: the map, and the ids of the route's blocks in order.
        obstacles: n road users and objects now.
        traffic: motion of the road users and objects, which may depend on what the ego does.
        red: state of the lights by id of a connector, (41,) whether its light is red.
        history: (H, 11) states before now, 0.1 s apart; None for none, which makes HC 1.
    """

    state: Array
    planner_map: PlannerMap
    route: tuple[str, ...]
    obstacles: tuple[Obstacle, ...] = ()
    traffic: Traffic = lambda states: np.zeros((0, STEPS + 1, 3))
    red: Mapping[str, BoolArray] = field(default_factory=dict)
    history: Array | None = None
    vehicle: VehicleParameters = PACIFICA


@dataclass(frozen=True)
class PlanScore:
    """What a plan scored.

    Attributes:
        scores: its sub-metrics, () each; EC needs a second plan.
        states: (41, 11) states of the ego that result from following the plan.
    """

    scores: ExtendedScores
    states: Array


def score_plan(situation: PlanSituation, waypoints: ArrayLike, interval: float = 0.1) -> PlanScore:
    """Drive a plan and PDM-Closed's with NAVSIM's tracker, and score the plan.

    Args:
        waypoints: (N, 3) x, y, heading of the rear axle in the ego frame at `interval`,
            2 `interval`, ... seconds.

    Raises:
        InputError: PDM-Closed cannot plan here: the map has no lanes, or the ego is far from the
            route.
        ValueError: the plan ends before 4 s.
    """
    pdm, reference = _pdm_closed(situation)
    states = _driven(
        situation, np.stack([reference, planned_poses(situation, waypoints, interval)])
    )
    return PlanScore(_scores(situation, pdm, states, states[1], situation.history).at(1), states[1])


def score_human(situation: PlanSituation, waypoints: ArrayLike, interval: float = 0.1) -> PlanScore:
    """Score what the human drove, as NAVSIM's human filter does: alone, and without a history.

    Args, Raises: as for `score_plan`.
    """
    pdm, _ = _pdm_closed(situation)
    states = _driven(situation, planned_poses(situation, waypoints, interval)[None])
    return PlanScore(_scores(situation, pdm, states, states[0], None).at(0), states[0])


def human_filtered(agent: ExtendedScores, human: ExtendedScores) -> ExtendedScores:
    """The agent's sub-metrics, 1 where the human's are 0."""
    return ExtendedScores(
        *(
            np.where(getattr(human, one.name) == 0.0, 1.0, getattr(agent, one.name))
            for one in fields(agent)
        )
    )


def planned_poses(situation: PlanSituation, waypoints: ArrayLike, interval: float) -> Array:
    """World poses (41, 3) at 0, 0.1, ..., 4 s of a plan; linear between its own, as in NAVSIM.

    Args, Raises: as for `score_plan`.
    """
    poses = plan_to_poses(situation.state[ego.POSE], waypoints)
    known = interval * np.arange(len(poses))
    if known[-1] < _HORIZON - 1e-6:
        raise ValueError(
            f"planned_poses: the plan ends at {known[-1]:g} s, {_HORIZON:g} s are needed"
        )
    times = np.linspace(0.0, _HORIZON, STEPS + 1)
    columns = (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))
    return np.stack([np.interp(times, known, column) for column in columns], axis=-1)


def _pdm_closed(situation: PlanSituation) -> tuple[PdmClosed, Array]:
    """PDM-Closed with its route and centreline, and its plan: world poses (41, 3)."""
    settings = PdmConfig(reference_quirks=True)
    pdm = PdmClosed(situation.planner_map, situation.route, situation.vehicle, settings)
    red_now = [lane for lane, red in situation.red.items() if red[0]]
    found = pdm.plan(situation.state, situation.obstacles, red_now)
    return pdm, found.trajectory[: STEPS + 1]


def _driven(situation: PlanSituation, poses: Array) -> Array:
    start = np.broadcast_to(situation.state, (len(poses), ego.SIZE))
    return track(start, poses, STEPS, PDM_REFERENCE, situation.vehicle)


def _scores(
    situation: PlanSituation, pdm: PdmClosed, states: Array, driven: Array, history: Array | None
) -> ExtendedScores:
    lanes = situation.planner_map.lanes
    on_route = situation.planner_map.lanes_of(pdm.route)
    lights = [(k, lanes[k].polygon, red) for k, red in situation.red.items() if k in on_route]
    return score_extended(
        states,
        observed(situation.obstacles, situation.traffic(driven), lights),
        pdm.centreline,
        situation.planner_map,
        on_route,
        situation.vehicle,
        history,
    )
