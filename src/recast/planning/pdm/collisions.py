"""At-fault collisions and time to collision of simulated proposals (nuPlan's rules)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.pdm.ego_areas import EgoAreas
from recast.planning.pdm.forecast import Forecast, Kind

Array = NDArray[np.float64]

_STOPPED = 0.05
"""m/s up to which an ego or another vehicle stands, when blame is given."""
_STOPPED_TTC = 0.005
"""m/s below which an ego cannot run into anything."""
_BEHIND, _AHEAD = np.deg2rad(150), np.deg2rad(30)
_LOOK_AHEAD = (0, 3, 6, 9)
"""Steps by which the ego is moved on at constant velocity, for the time to collision."""


@dataclass(frozen=True)
class Verdict:
    """One score per proposal.

    Attributes:
        score: (P,) 1, 0.5 or 0.
        first_step: (P,) the first step at fault, infinite without any.
    """

    score: Array
    first_step: Array


def at_fault_collisions(
    states: Array, corners: Array, areas: EgoAreas, forecast: Forecast
) -> Verdict:
    """NC: 0 after a collision at fault with a road user, 0.5 with an object, else 1.

    At fault: into something standing, with the front bumper, or sideways while across lanes or off
    the road. Not at fault: standing oneself, or hit from behind; such an obstacle no longer counts.

    Args:
        states: (P, T, 11).
        corners: (P, T, 4, 2), front left, rear left, rear right, front right.
        areas: flags (P, T).
        forecast: covers T steps.
    """
    verdict = _clean(len(states))
    ignored = _ignored(len(states), forecast)
    outlines = shapely.polygons(corners)
    for step in range(states.shape[1]):
        for p, k in forecast.touching(step, outlines[:, step]):
            if ignored[p, k]:
                continue
            bumper = corners[p, step, [0, 3]]
            irregular = bool(areas.irregular[p, step])
            if _at_fault(states[p, step], bumper, irregular, forecast, step, k):
                score = 0.0 if forecast.kinds[k].moves else 0.5
                verdict.score[p] = min(verdict.score[p], score)
                verdict.first_step[p] = min(verdict.first_step[p], step)
            else:
                ignored[p, k] = True
    return verdict


def time_to_collision(
    states: Array, corners: Array, areas: EgoAreas, forecast: Forecast, dt: float = 0.1
) -> Verdict:
    """TTC: 0 where a proposal comes within 0.9 s of a collision ahead, else 1.

    At every step the box is moved on at constant velocity by 0, 0.3, 0.6 and 0.9 s and compared
    with the forecast then. What it meets counts if less than 30 degrees off the heading; while the
    ego is across lanes, off the road or in an intersection, if not more than 150 degrees off. Else
    it no longer counts.

    The arguments are those of `at_fault_collisions`; the forecast covers 9 steps more.
    """
    verdict = _clean(len(states))
    ignored = _ignored(len(states), forecast)
    speed = np.hypot(states[..., ego.VX], states[..., ego.VY])
    heading = states[..., ego.HEADING]
    per_step = dt * speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    moved = np.stack([corners + f * per_step[..., None, :] for f in _LOOK_AHEAD], axis=2)
    outlines = shapely.polygons(moved)
    exposed = areas.irregular | areas.in_intersection
    for step in range(states.shape[1]):
        for i, ahead in enumerate(_LOOK_AHEAD):
            for p, k in forecast.touching(step + ahead, outlines[:, step, i]):
                if ignored[p, k] or speed[p, step] < _STOPPED_TTC:
                    continue
                bearing = _bearing(states[p, step], forecast.at(step + ahead)[k])
                if bearing < _AHEAD or (exposed[p, step] and bearing <= _BEHIND):
                    verdict.score[p] = 0.0
                    verdict.first_step[p] = min(verdict.first_step[p], step)
                else:
                    ignored[p, k] = True
    return verdict


def _at_fault(
    state: Array, bumper: Array, irregular: bool, forecast: Forecast, step: int, k: int
) -> bool:
    if np.hypot(state[ego.VX], state[ego.VY]) <= _STOPPED:
        return False
    if forecast.speeds[k] <= _STOPPED:
        return True
    shape = forecast.at(step)[k]
    if _bearing(state, shape) > _BEHIND:
        return False
    return bool(shapely.intersects(shapely.LineString(bumper), shape)) or irregular


def _bearing(state: Array, shape: shapely.Polygon) -> float:
    """Radians, 0 to pi, between the heading and the way from the rear axle to the centroid."""
    x, y = shapely.get_coordinates(shapely.centroid(shape))[0]
    course = np.arctan2(y - state[ego.Y], x - state[ego.X])
    return abs(float(se2.wrap_angle(course - state[ego.HEADING])))


def _clean(proposals: int) -> Verdict:
    return Verdict(np.ones(proposals), np.full(proposals, np.inf))


def _ignored(proposals: int, forecast: Forecast) -> NDArray[np.bool_]:
    """(P, n) obstacles that do not count for a proposal: touched before, or red lights."""
    red = np.array([kind is Kind.RED_LIGHT for kind in forecast.kinds], np.bool_)
    return np.tile(forecast.ignored | red, (proposals, 1))
