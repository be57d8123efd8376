"""The score of each simulated proposal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import VehicleParameters
from recast.dynamics import state as ego
from recast.planning.map import PlannerMap
from recast.planning.pdm.collisions import at_fault_collisions, time_to_collision
from recast.planning.pdm.comfort import is_comfortable
from recast.planning.pdm.ego_areas import EgoAreas, ego_areas
from recast.planning.pdm.footprint import box_centres, box_corners
from recast.planning.pdm.forecast import Forecast
from recast.planning.pdm.lane_path import LanePath

Array = NDArray[np.float64]

_MIN_PROGRESS = 0.1
"""Metres: where no proposal gets further, progress does not tell them apart."""
_PROGRESS, _TTC, _COMFORT = 5.0, 5.0, 2.0
"""Weights."""
_ONCOMING_TOLERATED, _ONCOMING_HALF = 2.0, 6.0
"""Metres on the wrong side below which the score is 1, and 0.5."""


@dataclass(frozen=True)
class Scores:
    """What the scorer finds, (P,) each.

    Attributes:
        no_collision, drivable, direction: NC, DAC and DDC, which multiply.
        progress, ttc, comfort: EP, TTC and C, weighted 5, 5 and 2.
        metres: progress along the centreline, not negative.
        collision_step, ttc_step: the first step at fault, infinite without any.
        areas: flags (P, T).
        total: NC * DAC * DDC * (5 EP + 5 TTC + 2 C) / 12.
    """

    no_collision: Array
    drivable: Array
    direction: Array
    progress: Array
    ttc: Array
    comfort: Array
    metres: Array
    collision_step: Array
    ttc_step: Array
    areas: EgoAreas
    total: Array


def score_proposals(
    states: Array,
    forecast: Forecast,
    centreline: LanePath,
    planner_map: PlannerMap,
    route_lanes: Iterable[str],
    vehicle: VehicleParameters,
    dt: float = 0.1,
    *,
    reference_quirks: bool = False,
) -> Scores:
    """Score simulated proposals (P, T, 11), T >= 15, with tuplan_garage's rules.

    Args:
        forecast: covers T + 9 steps.
        centreline: what progress is measured on.
        planner_map: lanes and drivable area around them.
        route_lanes: ids.
        reference_quirks: comfort is smoothed over all T samples, see `comfort_signals`.
    """
    poses = states[..., ego.POSE]
    corners, centres = box_corners(poses, vehicle), box_centres(poses, vehicle)
    areas = ego_areas(planner_map, route_lanes, corners, centres, poses)
    collision = at_fault_collisions(states, corners, areas, forecast)
    drivable = np.where(areas.non_drivable.any(axis=-1), 0.0, 1.0)
    direction = direction_compliance(centres, areas)
    ttc = time_to_collision(states, corners, areas, forecast, dt)
    comfort = is_comfortable(states, dt, whole_window=reference_quirks)

    ends = centreline.project(centres[:, [0, -1]])
    metres = np.maximum(ends[:, 1] - ends[:, 0], 0.0)
    allowed = collision.score * drivable * direction
    masked = metres * allowed
    if masked.max() > _MIN_PROGRESS:
        progress = masked / masked.max()
    else:
        progress = np.where(allowed == 0.0, 0.0, 1.0)
    weighted = _PROGRESS * progress + _TTC * ttc.score + _COMFORT * comfort
    return Scores(
        no_collision=collision.score,
        drivable=drivable,
        direction=direction,
        progress=progress,
        ttc=ttc.score,
        comfort=comfort,
        metres=metres,
        collision_step=collision.first_step,
        ttc_step=ttc.first_step,
        areas=areas,
        total=allowed * weighted / (_PROGRESS + _TTC + _COMFORT),
    )


def direction_compliance(centres: Array, areas: EgoAreas) -> Array:
    """DDC (P,): by the longest contiguous stretch off the route's lanes, in metres.

    Args:
        centres: (P, T, >=2) of the boxes.
        areas: flags (P, T).
    """
    moved = np.zeros(centres.shape[:2])
    moved[:, 1:] = np.linalg.norm(np.diff(centres[..., :2], axis=1), axis=-1)
    longest = np.zeros(len(centres))
    stretch = np.zeros(len(centres))
    for step in range(centres.shape[1]):
        stretch = np.where(areas.oncoming[:, step], stretch + moved[:, step], 0.0)
        longest = np.maximum(longest, stretch)
    return np.where(
        longest < _ONCOMING_TOLERATED, 1.0, np.where(longest < _ONCOMING_HALF, 0.5, 0.0)
    )
