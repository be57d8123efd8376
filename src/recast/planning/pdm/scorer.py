"""The score of each simulated proposal: PDM's own, of nuPlan, and NAVSIM v2's extended one (EPDMS).

EPDMS = NC DAC DDC TLC (5 EP + 5 TTC + 2 LK + 2 HC + 2 EC) / 16; without EC, over 14. The rules are
those of NAVSIM's code; `docs/metrics.md` has worked numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray, Int64Array
from recast.dynamics import PACIFICA, VehicleParameters
from recast.dynamics import state as ego
from recast.dynamics.tracker import NUPLAN_LIMITS, check, savgol_signals
from recast.geometry import se2
from recast.planning.map import PlannerMap
from recast.planning.pdm.forecast import Forecast, box_centres, box_corners
from recast.planning.pdm.proposals import Centreline


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
"""Weights of the weighted sub-metrics; `EXTENDED_COMFORT_WEIGHT` is EC's."""
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
