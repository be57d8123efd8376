"""Scores that other simulators give a rollout: AlpaSim's of a scene, and NeuroNCAP's.

AlpaSim's is no collision at fault, on the road, along the recorded drive. NeuroNCAP's is five stars
without a collision, else by how much of the speed was lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray
from recast.dynamics import state as ego
from recast.geometry import boxes
from recast.logs.hdmap import HdMap, drivable_region
from recast.metrics.rollout_metrics import rollout_actors, rollout_collisions
from recast.metrics.table import Metric, invalid
from recast.simulation.rollout import Rollout, ego_centre

_ENOUGH = 0.8
"""Share of the recorded path that scores 1."""
_SHORTEST = 5.0
"""Metres: on a shorter recorded path progress does not count."""
_CORRIDOR = 4.0
"""Metres from the recorded path at which the score stops looking."""
_LANES_WITHIN = 6.0
"""Metres from the ego's centre to the centrelines of lanes that it may be on."""
_EDGE, _SEAM = 1e-3, 5e-4
"""Metres: a road edge this near is touched; half of a gap between areas that is none."""


@dataclass(frozen=True)
class SceneScore:
    """AlpaSim's scene score of a rollout.

    Attributes:
        score: 0 to 1; `reason` says what took it to 0, or the progress below 80 %.
        progress: share of the recorded path's length at the last step that counts.
        last_step: the last step that counts.
        contact, at_fault, off_road: (S+1,) the ego touches an actor; does so at fault; is off the
            road.
        distance: (S+1,) metres from the ego's box centre to the recorded path.
    """

    score: Metric
    progress: float
    last_step: int
    contact: BoolArray
    at_fault: BoolArray
    off_road: BoolArray
    distance: Array

    def to_json(self) -> dict[str, Any]:
        """Plain values by name."""
        return {
            **self.score.to_json(),
            "progress": self.progress,
            "last_step": self.last_step,
            "largest_distance_m": float(self.distance.max()) if len(self.distance) else None,
        }


def alpasim_scene_score(
    rollout: Rollout,
    hd_map: HdMap | None,
    road_edges: Sequence[ArrayLike] | None = None,
    *,
    last_contact_only: bool = True,
    corridor_fails: bool = False,
) -> SceneScore:
    """0 after a collision at fault or off the road, else min(progress / 0.8, 1).

    Counted are the steps up to the first contact (with or without fault) or the first one off the
    road, and up to the first one 4 m from the recorded path; that step included. Progress is that
    of the last of them. The recorded path is the log's over the time of the rollout; where it is
    shorter than 5 m, progress counts as 1. All positions are those of the box centre.

    Args:
        hd_map: map of the log.
        road_edges: see `off_road`.
        last_contact_only: AlpaSim's slip: of several actors touched in one step the last decides
            whether the ego is at fault. Off: any of them.
        corridor_fails: whether 4 m to the side of the recorded path are a failure, as in the
            challenge's later rules; beyond its end only the distance from its last direction
            counts.
    """
    region = drivable_region(hd_map)
    nothing = np.zeros(0, np.bool_)
    if hd_map is None or region is None:
        reason = "no drivable area in the map"
        return SceneScore(invalid(reason), 0.0, 0, nothing, nothing, nothing, np.zeros(0))
    if rollout.steps_run < 2:
        reason = "the rollout has fewer than three states"
        return SceneScore(invalid(reason), 0.0, 0, nothing, nothing, nothing, np.zeros(0))
    contact, at_fault = _contacts(rollout, last_contact_only)
    outside = off_road(rollout.ego_boxes, rollout.ego_size, hd_map, road_edges)
    recorded = ego_centre(rollout.log_ego[:, :3], rollout.ego_centre_offset)[:, :2]
    path = shapely.LineString(recorded)
    centres = shapely.points(rollout.ego_boxes[:, :2])
    distance = np.asarray(shapely.distance(path, centres), np.float64)
    distance[:2] = 0.0  # AlpaSim makes up the first two steps, the progress below too
    along = np.asarray(shapely.line_locate_point(path, centres), np.float64)
    along /= max(path.length, _EDGE)
    along[:2] = 0.0, along[2] / 2
    last = min(_first(contact | outside), _first(distance >= _CORRIDOR), rollout.steps_run)
    progress = float(along[last])
    failures = {"collision at fault": at_fault, "off the road": outside}
    if corridor_fails:
        failures["left the corridor sideways"] = _aside(recorded, path, rollout) >= _CORRIDOR
    failed = [
        f"{name} at step {last}" for name, flags in failures.items() if flags[: last + 1].any()
    ]
    enough = path.length < _SHORTEST or progress >= _ENOUGH
    if failed:
        score = Metric(0.0, failed[0])
    elif enough:
        score = Metric(1.0)
    else:
        score = Metric(progress / _ENOUGH, f"{100 * progress:.0f} % of the recorded path")
    return SceneScore(score, progress, last, contact, at_fault, outside, distance)


def off_road(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    hd_map: HdMap,
    road_edges: Sequence[ArrayLike] | None = None,
) -> BoolArray:
    """Whether the ego is off the road, (N,).

    It is not where one lane within 6 m contains its box, or all of them together. Else it is where
    its box touches the nearest road edge; without edges, as in nuPlan's maps, where the road areas
    do not cover it (gaps of a millimetre between them do not count).

    Args:
        ego_boxes: (N, 3) x, y, heading of the box centre.
        ego_size: (>=2,) length and width in metres.
        road_edges: lines (M, >=2) along the edges of the road, at least one; None for a map
            without.
    """
    poses = np.asarray(ego_boxes, np.float64)
    length, width = np.asarray(ego_size, np.float64)[:2]
    egos, centres = (
        shapely.polygons(boxes.bev_corners(poses, length, width)),
        shapely.points(poses[:, :2]),
    )
    outside = ~_in_lanes(egos, centres, hd_map)
    steps = np.flatnonzero(outside)
    if road_edges is not None:
        edges = [shapely.LineString(np.asarray(edge, np.float64)[:, :2]) for edge in road_edges]
        nearest = shapely.STRtree(edges).nearest(centres[steps])
        outside[steps] = shapely.distance(np.take(edges, nearest), egos[steps]) < _EDGE
        return outside
    region = drivable_region(hd_map)
    closed = shapely.buffer(region, _SEAM, join_style="mitre")
    closed = shapely.buffer(closed, -_SEAM, join_style="mitre")
    shapely.prepare(closed)
    outside[steps] = ~shapely.covers(closed, egos[steps])
    return outside


def _in_lanes(egos: NDArray[Any], centres: NDArray[Any], hd_map: HdMap) -> BoolArray:
    """(N,) one lane near the centre contains the box, or the union of those near does."""
    found = np.zeros(len(egos), np.bool_)
    if not hd_map.lanes:
        return found
    lanes = [
        (
            shapely.LineString(one.centreline[:, :2]),
            shapely.make_valid(shapely.Polygon(one.polygon)),
        )
        for one in hd_map.lanes.values()
    ]
    middles, areas = (np.array(part, np.object_) for part in zip(*lanes, strict=True))
    step, lane = shapely.STRtree(middles).query(
        centres, predicate="dwithin", distance=_LANES_WITHIN
    )
    np.logical_or.at(found, step, shapely.contains(areas[lane], egos[step]))
    for k in np.unique(step[~found[step]]):
        found[k] = bool(shapely.contains(shapely.union_all(areas[lane[step == k]]), egos[k]))
    return found


def _contacts(rollout: Rollout, last_only: bool) -> tuple[BoolArray, BoolArray]:
    """(S+1,) each: the ego touches an actor, and is at fault: with its front bumper or a side."""
    length, width = rollout.ego_size
    corners = boxes.bev_corners(rollout.ego_boxes, length, width)
    egos = shapely.polygons(corners)
    front, rear = (shapely.linestrings(corners[:, ends]) for ends in ([0, 3], [1, 2]))
    contact, fault = np.zeros(len(egos), np.bool_), np.zeros(len(egos), np.bool_)
    for actor in rollout_actors(rollout):
        others = shapely.polygons(boxes.bev_corners(actor.states[:, :3], *actor.size[:2]))
        touched = shapely.intersects(egos, others)
        own = shapely.intersects(front, others) | ~shapely.intersects(rear, others)
        fault = np.where(touched, own if last_only else fault | own, fault)
        contact |= touched
    return contact, fault


def _aside(recorded: Array, path: shapely.LineString, rollout: Rollout) -> Array:
    """(S+1,) metres to the side of the recorded path; beyond its end, of its last direction."""
    centres = rollout.ego_boxes[:, :2]
    points = shapely.points(centres)
    aside = np.asarray(shapely.distance(path, points), np.float64)
    last = recorded[-1] - recorded[-2]
    norm = float(np.hypot(*last))
    if norm > 0:
        offset = centres - recorded[-1]
        across = np.abs(offset[:, 0] * last[1] - offset[:, 1] * last[0]) / norm
        beyond = shapely.line_locate_point(path, points) >= path.length - 1e-9
        aside = np.where(beyond, across, aside)
    aside[:2] = 0.0
    return aside


def _first(flags: BoolArray) -> int:
    """Index of the first one that is set; far beyond the end where none is."""
    return int(np.argmax(flags)) if flags.any() else np.iinfo(np.int64).max


Reference = Literal["four-seconds", "log-end"]
"""When the recorded ego's speed is taken: 4 s after the start, as NeuroNCAP's protocol says; or at
the end of the recording, as its code does."""

_BEST, _BEST_HIT = 5.0, 4.0
_NOMINAL = 4.0
"""Seconds after the start at which an ego that does not react would hit."""
_STANDS = 0.1
"""m/s of reference speed below which the share of it that was lost is that of the noise of poses: a
centimetre in the 0.1 s of a step."""
_LAST = 0.5
"""Seconds at the end of the recording whose mean speed `log-end` takes."""


@dataclass(frozen=True)
class NcapScore:
    """NeuroNCAP's score of a rollout.

    Attributes:
        score: 0 to 5 stars; no value after a collision with a reference speed below 0.1 m/s.
        impact_speed: m/s of the ego against the actor at the first contact, or None without one.
        reference_speed: m/s of the recorded ego against the target, without any reaction.
    """

    score: Metric
    impact_speed: float | None
    reference_speed: float

    @property
    def collides(self) -> bool:
        """Whether the ego touches a controlled actor."""
        return self.impact_speed is not None

    def to_json(self) -> dict[str, Any]:
        """Plain values by name."""
        speeds = {"impact_speed": self.impact_speed, "reference_speed": self.reference_speed}
        return {**self.score.to_json(), **speeds, "any_collide": self.collides}


def neuroncap_score(rollout: Rollout, reference: Reference = "four-seconds") -> NcapScore:
    """5 without a collision, else 4 max(0, 1 - impact speed / reference speed).

    Both speeds are lengths of the difference of two velocities. Boxes are the rollout's:
    NeuroNCAP's ego is 4.018 m by 1.85 m. In rollouts that end before 4 s, their last step stands
    for the time without a reaction.
    """
    dt, steps = rollout.dt, rollout.steps_run
    nominal = min(round(_NOMINAL / dt), steps - 1)
    first = max(0, steps - max(1, round(_LAST / dt))) if reference == "log-end" else nominal
    last = steps if reference == "log-end" else nominal + 1
    unhindered = _velocity(rollout.log_ego, first, last, dt)
    target = _velocity(rollout.actor, nominal, nominal + 1, dt)
    reference_speed = float(np.hypot(*(unhindered - target)))

    found = rollout_collisions(rollout)
    hits = {key: one.first_step for key, one in found.items() if one.first_step is not None}
    if not hits:
        return NcapScore(Metric(_BEST), None, reference_speed)
    key = min(hits, key=lambda one: hits[one])
    step = hits[key]
    actor = next(one for one in rollout_actors(rollout) if one.track_id == key)
    before = max(0, step - 1)
    heading, speed = rollout.ego[step, ego.HEADING], rollout.ego[step, ego.VX]
    own = speed * np.array([np.cos(heading), np.sin(heading)])
    impact = float(np.hypot(*(own - _velocity(actor.states, before, before + 1, dt))))
    if reference_speed < _STANDS:
        score = invalid(
            "the reference speed is 0: without a reaction, the ego would not approach the actor"
        )
    else:
        value = _BEST_HIT * max(0.0, 1.0 - impact / reference_speed)
        reason = f"hits {actor.name} at step {step} at {impact:.1f} m/s"
        reason += f" (reference {reference_speed:.1f} m/s)"
        score = Metric(value, reason)
    return NcapScore(score, impact, reference_speed)


def neuroncap_mean(scores: Mapping[str, Mapping[str, Sequence[float]]]) -> float:
    """NeuroNCAP's average: over the runs of a sequence, then over sequences, then categories.

    Args:
        scores: scores of each run, by category and sequence; none empty.
    """
    return float(np.mean([np.mean([np.mean(r) for r in one.values()]) for one in scores.values()]))


def _velocity(path: ArrayLike, first: int, last: int, dt: float) -> Array:
    """Mean velocity (2,) in m/s of positions (S+1, >=2) between two steps."""
    position = np.asarray(path, np.float64)[:, :2]
    return np.asarray((position[last] - position[first]) / ((last - first) * dt))
