"""The score of each simulated proposal: where it is, collisions, comfort, progress (nuPlan)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray, Int64Array
from recast.dynamics import VehicleParameters
from recast.dynamics import state as ego
from recast.dynamics.tracker import NUPLAN_LIMITS, check, savgol_signals
from recast.geometry import se2
from recast.planning.map import PlannerMap
from recast.planning.pdm.centreline import Centreline
from recast.planning.pdm.forecast import Forecast, box_centres, box_corners


@dataclass(frozen=True)
class EgoAreas:
    """Flags (...) of ego boxes.

    Attributes:
        multiple_lanes: more than one lane or car park holds a corner, and none holds all four.
        non_drivable: some corner lies in no drivable polygon.
        oncoming: the centre lies in no lane of the route.
        in_intersection: the rear axle lies inside an intersection.
    """

    multiple_lanes: BoolArray
    non_drivable: BoolArray
    oncoming: BoolArray
    in_intersection: BoolArray

    def first(self, steps: int) -> EgoAreas:
        """The flags (..., T) of the first steps."""
        return EgoAreas(*(getattr(self, one.name)[..., :steps] for one in fields(self)))

    @property
    def irregular(self) -> BoolArray:
        """Where the ego is to blame for a collision from the side."""
        return self.multiple_lanes | self.non_drivable


def ego_areas(
    planner_map: PlannerMap,
    route_lanes: Iterable[str],
    corners: ArrayLike,
    centres: ArrayLike,
    rear_axles: ArrayLike,
    *,
    lanes_only: bool = False,
) -> EgoAreas:
    """Flags of ego boxes; a point on a polygon's edge is outside it.

    Args:
        lanes_only: leave car parks out of `multiple_lanes`, as NAVSIM does; tuplan_garage counts
            every polygon of its drivable map, which are lanes and car parks.
        corners: (..., 4, 2) corners of the boxes.
        centres: (..., >=2) centres of the boxes.
        rear_axles: (..., >=2) rear axles.
    """
    corners = np.asarray(corners, np.float64)
    centres = np.asarray(centres, np.float64)[..., None, :2]
    shape = corners.shape[:-2]
    on_route = set(route_lanes)
    drivable = planner_map.drivable_hits(corners)
    touched = np.zeros(shape, np.int64)
    whole, with_route = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    polygons = [] if lanes_only else planner_map.car_park_hits(corners)
    for lane, hits in planner_map.lane_hits(np.concatenate([corners, centres], axis=-2)).items():
        drivable |= hits[..., :4]
        polygons.append(hits[..., :4])
        if lane in on_route:
            with_route |= hits[..., 4]
    for of_corners in polygons:
        touched += of_corners.any(axis=-1)
        whole |= of_corners.all(axis=-1)
    return EgoAreas(
        multiple_lanes=np.asarray((touched > 1) & ~whole),
        non_drivable=np.asarray(~drivable.all(axis=-1)),
        oncoming=~with_route,
        in_intersection=planner_map.in_intersection(np.asarray(rear_axles, np.float64)[..., :2]),
    )


_STOPPED = 0.05
"""m/s up to which an ego or another vehicle stands, when blame is given."""
_STOPPED_TTC = 0.005
"""m/s below which an ego cannot run into anything."""
_BEHIND, _AHEAD = np.deg2rad(150), np.deg2rad(30)
_LOOK_AHEAD = (0, 3, 6, 9)
"""Steps by which the ego is moved on at constant velocity, for the time to collision."""
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
    centreline: Centreline,
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
        centres: (P, T, >=2) centres of the boxes.
        areas: flags (P, T).
    """
    moved = np.zeros(centres.shape[:2])
    moved[:, 1:] = np.linalg.norm(np.diff(centres[..., :2], axis=1), axis=-1)
    longest = np.zeros(len(centres))
    stretch = np.zeros(len(centres))
    for step in range(centres.shape[1]):
        stretch = np.where(areas.oncoming[:, step], stretch + moved[:, step], 0.0)
        longest = np.maximum(longest, stretch)
    return graded_direction(longest)


def graded_direction(metres: Array) -> Array:
    """Scores (...) of metres (...) on the wrong side: below 2 m 1, below 6 m 0.5, else 0."""
    return np.where(metres < _ONCOMING_TOLERATED, 1.0, np.where(metres < _ONCOMING_HALF, 0.5, 0.0))


@dataclass(frozen=True)
class ProposalVerdict:
    """One score per proposal.

    Attributes:
        score: (P,) 1, 0.5 or 0.
        first_step: (P,) the first step at fault, infinite without any.
    """

    score: Array
    first_step: Array


def at_fault_collisions(
    states: Array, corners: Array, areas: EgoAreas, forecast: Forecast
) -> ProposalVerdict:
    """NC: 0 after a collision at fault with a road user, 0.5 with an object, else 1.

    At fault: into something standing, with the front bumper, or sideways while across lanes or off
    the road. Not at fault: standing oneself, or hit from behind; such an obstacle no longer counts.

    Args:
        states: (P, T, 11).
        corners: (P, T, 4, 2), front left, rear left, rear right, front right.
        areas: flags (P, T).
        forecast: covers T steps.
    """
    count, steps = states.shape[:2]
    first = forecast.first_contacts(corners, np.arange(steps), np.ones((count, steps), np.bool_))
    p, k = np.nonzero(first < steps)
    step = first[p, k]
    state, shapes = states[p, step], forecast.polygons[step // forecast.stride, k]
    bumpers = shapely.linestrings(corners[p, step][:, [0, 3]])
    in_front = shapely.intersects(bumpers, shapes) | areas.irregular[p, step]
    fault = (forecast.speeds[k] <= _STOPPED) | ((_bearing(state, shapes) <= _BEHIND) & in_front)
    fault &= np.hypot(state[:, ego.VX], state[:, ego.VY]) > _STOPPED
    moves = np.array([kind.moves for kind in forecast.kinds], np.bool_)
    return _verdict(count, p[fault], np.where(moves[k], 0.0, 0.5)[fault], step[fault])


def time_to_collision(
    states: Array, corners: Array, areas: EgoAreas, forecast: Forecast, dt: float = 0.1
) -> ProposalVerdict:
    """TTC: 0 where a proposal comes within 0.9 s of a collision ahead, else 1.

    At every step the box is moved on at constant velocity by 0, 0.3, 0.6 and 0.9 s and compared
    with the forecast then. What it meets counts if less than 30 degrees off the heading; while the
    ego is across lanes, off the road or in an intersection, if not more than 150 degrees off. Else
    it no longer counts.

    The arguments are those of `at_fault_collisions`; the forecast covers 9 steps more.
    """
    count, steps = states.shape[:2]
    speed = np.hypot(states[..., ego.VX], states[..., ego.VY])
    heading = states[..., ego.HEADING]
    per_step = dt * speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    moved = np.stack([corners + f * per_step[..., None, :] for f in _LOOK_AHEAD], axis=2)
    looks = np.add.outer(np.arange(steps), _LOOK_AHEAD).ravel()
    moving = np.repeat(speed >= _STOPPED_TTC, len(_LOOK_AHEAD), axis=1)
    first = forecast.first_contacts(moved.reshape(count, -1, 4, 2), looks, moving)
    p, k = np.nonzero(first < len(looks))
    step = first[p, k] // len(_LOOK_AHEAD)
    bearing = _bearing(states[p, step], forecast.polygons[looks[first[p, k]] // forecast.stride, k])
    exposed = (areas.irregular | areas.in_intersection)[p, step]
    fault = (bearing < _AHEAD) | (exposed & (bearing <= _BEHIND))
    return _verdict(count, p[fault], np.zeros(np.count_nonzero(fault)), step[fault])


def _bearing(states: Array, shapes: NDArray[np.object_]) -> Array:
    """Radians (N,), 0 to pi, between headings and the ways from the rear axles to centroids."""
    x, y = shapely.get_coordinates(shapely.centroid(shapes)).T
    course = np.arctan2(y - states[:, ego.Y], x - states[:, ego.X])
    return np.abs(se2.wrap_angle(course - states[:, ego.HEADING]))


def _verdict(proposals: int, p: Int64Array, scores: Array, steps: Int64Array) -> ProposalVerdict:
    """The worst score and the first step of the faults (F,) of each proposal."""
    verdict = ProposalVerdict(np.ones(proposals), np.full(proposals, np.inf))
    np.minimum.at(verdict.score, p, scores)
    np.minimum.at(verdict.first_step, p, steps)
    return verdict


def comfort_signals(
    states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False
) -> dict[str, Array]:
    """Smoothed signals (..., T) of states (..., T, 11) at the rear axle, T >= 15.

    For `whole_window` see `savgol_signals`.
    """
    states = np.asarray(states, np.float64)
    lon, lat = states[..., ego.AX], states[..., ego.AY]
    return savgol_signals(
        lon, lat, np.hypot(lon, lat), states[..., ego.HEADING], dt, whole_window=whole_window
    )


def is_comfortable(states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False) -> Array:
    """1 where all six signals of states (..., T, 11) stay strictly within limits, else 0."""
    signals = comfort_signals(states, dt, whole_window=whole_window)
    return np.asarray(check(signals, NUPLAN_LIMITS, strict=True).all(axis=-1), np.float64)
