"""NAVSIM v2's extended PDM score (EPDMS) of simulated proposals.

EPDMS = NC DAC DDC TLC (5 EP + 5 TTC + 2 LK + 2 HC + 2 EC) / 16; without EC, over 14. The rules are
those of NAVSIM's code; `docs/metrics.md` has worked numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.dynamics import PACIFICA, VehicleParameters
from recast.dynamics import state as ego
from recast.dynamics.tracker import NUPLAN_LIMITS, check, savgol_signals
from recast.planning.map import PlannerMap
from recast.planning.pdm.centreline import Centreline
from recast.planning.pdm.forecast import Forecast, box_centres, box_corners
from recast.planning.pdm.scorer import (
    at_fault_collisions,
    ego_areas,
    graded_direction,
    time_to_collision,
)

STEPS = 40
"""Steps of 0.1 s of a proposal."""
_DT = 0.1
_LOOKED_AHEAD = 9
"""Steps that TTC looks ahead; it is checked as long as they lie within the proposal."""
_DIRECTION_WINDOW = 10
"""Steps of the window of DDC: 1 s, which has 11 samples."""
_OFF_LANE, _OFF_LANE_SAMPLES = 0.5, 20
"""Metres off the centreline, and samples in a row (2 s)."""
_LEAST_PROGRESS = 5.0
"""Metres: where no proposal gets further, progress tells none apart."""
WEIGHTS = {"progress": 5.0, "ttc": 5.0, "lane_keeping": 2.0, "history_comfort": 2.0}
"""Of the weighted sub-metrics; `EXTENDED_COMFORT_WEIGHT` is EC's."""
EXTENDED_COMFORT_WEIGHT = 2.0
EXTENDED_COMFORT_LIMITS = {"acceleration": 0.7, "jerk": 0.5, "yaw_rate": 0.1, "yaw_accel": 0.1}
"""m/s^2, m/s^3, rad/s, rad/s^2: largest root mean square differences of two plans."""
LONGEST_INTERVAL = 0.55
"""Seconds: plans further apart are not compared."""


@dataclass(frozen=True)
class ExtendedScores:
    """Sub-metrics of P proposals, (P,) each, or () of one; 0 to 1.

    Attributes:
        no_collision, drivable, direction, traffic_light: NC, DAC, DDC and TLC, which multiply.
        progress, ttc, lane_keeping, history_comfort: EP, TTC, LK and HC, weighted 5, 5, 2 and 2.
    """

    no_collision: Array
    drivable: Array
    direction: Array
    traffic_light: Array
    progress: Array
    ttc: Array
    lane_keeping: Array
    history_comfort: Array

    def at(self, proposal: int) -> ExtendedScores:
        """The sub-metrics () of one proposal."""
        return ExtendedScores(*(getattr(self, one.name)[proposal] for one in fields(self)))

    def total(self, extended_comfort: ArrayLike | None = None) -> Array:
        """EPDMS (P,) with EC (P,), or without it as NAVSIM's score of one scene."""
        weighted = sum(weight * getattr(self, name) for name, weight in WEIGHTS.items())
        weights = sum(WEIGHTS.values())
        if extended_comfort is not None:
            weighted = weighted + EXTENDED_COMFORT_WEIGHT * np.asarray(extended_comfort, np.float64)
            weights += EXTENDED_COMFORT_WEIGHT
        allowed = self.no_collision * self.drivable * self.direction * self.traffic_light
        return np.asarray(allowed * weighted / weights)


def score_extended(
    states: Array,
    forecast: Forecast,
    centreline: Centreline,
    planner_map: PlannerMap,
    route_lanes: Iterable[str],
    vehicle: VehicleParameters = PACIFICA,
    history: ArrayLike | None = None,
) -> ExtendedScores:
    """Score simulated proposals (P, 41, 11), 0.1 s apart, with NAVSIM v2's rules.

    Progress is compared with the best of the proposals: NAVSIM's are PDM-Closed's and the agent's.

    Args:
        forecast: covers 40 steps; see `recast.planning.pdm.forecast.observed`.
        centreline: path for progress and lane keeping.
        history: see `history_comfort`.

    Raises:
        ValueError: the proposals are not of 41 states.
    """
    if states.ndim != 3 or states.shape[1:] != (STEPS + 1, ego.SIZE):
        raise ValueError(f"score_extended: expected (P, {STEPS + 1}, 11), got {states.shape}")
    poses = states[..., ego.POSE]
    corners, centres = box_corners(poses, vehicle), box_centres(poses, vehicle)
    areas = ego_areas(planner_map, route_lanes, corners, centres, poses, lanes_only=True)
    crossing = planner_map.in_intersection(centres[..., :2])
    collision = at_fault_collisions(states, corners, areas, forecast)
    drivable = np.where(areas.non_drivable.any(axis=-1), 0.0, 1.0)
    direction = window_direction(centres, areas.oncoming & ~crossing)
    light = traffic_light_compliance(corners, forecast)
    checked = STEPS + 1 - _LOOKED_AHEAD
    ttc = time_to_collision(
        states[:, :checked], corners[:, :checked], areas.first(checked), forecast, _DT
    )
    ends = centreline.project(centres[:, [0, -1]])
    metres = np.maximum(ends[:, 1] - ends[:, 0], 0.0)
    best = float((metres * collision.score * drivable * direction * light).max())
    far = best > _LEAST_PROGRESS
    return ExtendedScores(
        no_collision=collision.score,
        drivable=drivable,
        direction=direction,
        traffic_light=light,
        progress=np.minimum(metres / best, 1.0) if far else np.ones(len(states)),
        ttc=ttc.score,
        lane_keeping=lane_keeping(centres, crossing, centreline),
        history_comfort=history_comfort(states, history, vehicle),
    )


def window_direction(centres: Array, oncoming: BoolArray) -> Array:
    """DDC (P,): by the most metres off the route's lanes within any 1 s; <2 m 1, <6 m 1/2, else 0.

    Args:
        centres: (P, T, >=2) centres of the boxes.
        oncoming: (P, T) the centre is in no lane of the route, and in no intersection.
    """
    moved = np.zeros(centres.shape[:2])
    moved[:, 1:] = np.linalg.norm(np.diff(centres[..., :2], axis=1), axis=-1)
    driven = np.cumsum(np.where(oncoming, moved, 0.0), axis=1)
    before = np.zeros_like(driven)
    before[:, _DIRECTION_WINDOW + 1 :] = driven[:, : -_DIRECTION_WINDOW - 1]
    return graded_direction((driven - before).max(axis=1))


def traffic_light_compliance(corners: Array, forecast: Forecast) -> Array:
    """TLC (P,): 0 where a box touches the polygon of a connector while its light is red, else 1.

    Args:
        corners: (P, T, 4, 2) corners of the boxes.
        forecast: covers T steps.
    """
    boxes = shapely.polygons(corners)
    met = np.zeros(boxes.shape, np.bool_)
    for step in range(boxes.shape[1]) if forecast.red.any() else ():
        lights = forecast.at(step)[forecast.red]
        met[:, step] = shapely.intersects(boxes[:, step, None], lights).any(axis=1)
    return np.where(met.any(axis=1), 0.0, 1.0)


def lane_keeping(centres: Array, crossing: BoolArray, centreline: Centreline) -> Array:
    """LK (P,): 0 after 20 samples in a row more than 0.5 m off the centreline, else 1.

    Samples in an intersection are skipped; they do not end a row.

    Args:
        centres: (P, T, >=2) centres of the boxes.
        crossing: (P, T) whether the centre is in an intersection.
    """
    off = shapely.distance(centreline.line, shapely.points(centres[..., :2])) > _OFF_LANE
    running, longest = np.zeros(len(off)), np.zeros(len(off))
    for step in range(off.shape[1]):
        row = np.where(off[:, step], running + 1, 0.0)
        running = np.where(crossing[:, step], running, row)
        longest = np.maximum(longest, running)
    return np.where(longest >= _OFF_LANE_SAMPLES, 0.0, 1.0)


def history_comfort(
    states: Array, history: ArrayLike | None, vehicle: VehicleParameters = PACIFICA
) -> Array:
    """HC (P,): nuPlan's six comfort limits over the history and the proposals (P, T, 11).

    Accelerations along the axes are those of the box centre, the magnitude the rear axle's.

    Args:
        history: (H, 11) past states 0.1 s apart, the last one right before the first state; None
            gives 1, as NAVSIM does without a history. NAVSIM's own ends 0.2 s before the present
            and is joined as if there were no gap.
    """
    if history is None:
        return np.ones(len(states))
    past = np.asarray(history, np.float64)
    past = np.broadcast_to(past, (len(states), *past.shape))
    states = np.concatenate([past, states], axis=1)
    turn, twist = states[..., ego.ANGULAR_VELOCITY], states[..., ego.ANGULAR_ACCELERATION]
    magnitude = np.hypot(states[..., ego.AX], states[..., ego.AY])
    lon = states[..., ego.AX] + vehicle.centre_offset * (turn**2 + twist)
    signals = savgol_signals(lon, states[..., ego.AY], magnitude, states[..., ego.HEADING], _DT)
    return np.asarray(check(signals, NUPLAN_LIMITS, strict=True).all(axis=-1), np.float64)


def extended_comfort(now: ArrayLike, previous: ArrayLike, interval: float) -> float:
    """EC: 1 if two simulated plans, made `interval` seconds apart, move alike where they overlap.

    The root mean square differences of acceleration, jerk (magnitudes at the rear axle), yaw rate
    and yaw acceleration must all be within `EXTENDED_COMFORT_LIMITS`.

    Args:
        now, previous: (T, 11) states 0.1 s apart, each from the time of its plan on.

    Raises:
        ValueError: the interval is not within 0 to 0.55 s, or the overlap is shorter than 15
            states.
    """
    if not 0 < interval < LONGEST_INTERVAL:
        raise ValueError(f"extended_comfort: interval {interval:g} s, not within 0 to 0.55 s")
    later, first = round(interval / _DT), np.asarray(now, np.float64)
    both = np.stack([first[: len(first) - later], np.asarray(previous, np.float64)[later:]])
    magnitude = np.hypot(both[..., ego.AX], both[..., ego.AY])
    heading = both[..., ego.HEADING]
    signals = savgol_signals(magnitude, magnitude, magnitude, heading, _DT, yaw_accel_order=2)
    compared = {"acceleration": "lon_accel", "jerk": "jerk"}
    alike = all(
        np.sqrt(np.mean(np.diff(signals[compared.get(name, name)], axis=0) ** 2)) <= limit
        for name, limit in EXTENDED_COMFORT_LIMITS.items()
    )
    return float(alike)
