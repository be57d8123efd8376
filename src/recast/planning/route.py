"""The reference route: the logged ego path, smoothed, with its headings and speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import Polyline, se2
from recast.geometry.se2 import REACH
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import Trajectory

_KNOT_SPACING = 2.0
"""Metres between spline knots: wide enough that centimetres of pose noise leave headings smooth."""
_SAMPLE_SPACING = 0.5
_CUSP_LENGTH, _CUSP_TURN = 4.0, 2.0
"""Metres, and radians over them, that no car turns in: its radius is 4.5 m or more."""
_COMMAND_LOOKAHEAD = 20.0
_COMMAND_OFFSET = 2.0
_LANE_DISTANCE = 2.5
_LANE_ANGLE = np.pi / 4


class DrivingCommand(StrEnum):
    """Where the route leads next, as planners trained on OpenScene expect it."""

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class ReferenceRoute:
    """A smooth directed path with Frenet coordinates: s along, lateral to the left, metres.

    Attributes:
        line: the path, sampled every half metre.
        headings: (N,) tangent at its points, unwrapped radians.
        speeds: (N,) logged speed at its points, m/s.
        seconds: (N,) log time at its points, or None for a route that is no drive.
    """

    line: Polyline
    headings: Array
    speeds: Array
    seconds: Array | None = None

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory) -> ReferenceRoute:
        """The route of a logged drive: a cubic spline through positions 2 m apart.

        Raises:
            InputError: the log moves less than 4 m, so that there is no route.
        """
        xy = trajectory.poses[:, :2, 3]
        knots = _knots(xy)
        if len(knots) < 3:
            raise InputError(
                "log",
                "world_from_rig",
                f"the ego moves less than {2 * _KNOT_SPACING:g} m, so there is no route to follow",
                "use a part of the log in which the ego drives",
            )
        chord = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(xy[knots], axis=0), axis=1))]
        )
        spline = CubicSpline(chord, xy[knots])
        u = np.linspace(0.0, chord[-1], int(np.ceil(chord[-1] / _SAMPLE_SPACING)) + 1)
        line = Polyline(spline(u))
        tangent = spline(u, 1)
        seconds = trajectory.timestamps_us[knots] * 1e-6
        # Time over arc length is monotone where speed over arc length would need smoothing.
        elapsed = np.interp(u, chord, seconds)
        return cls(
            line=line,
            headings=np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])),
            speeds=np.gradient(line.arc_lengths, elapsed),
            seconds=elapsed,
        )

    @property
    def length(self) -> float:
        """Metres from end to end."""
        return self.line.length

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...), continuous in s; constant beyond the ends."""
        angle: Array = np.interp(np.asarray(s, np.float64), self.line.arc_lengths, self.headings)
        return se2.wrap_angle(angle)

    def logged_speed(self, s: ArrayLike) -> Array:
        """Speed (...) in m/s at which the log drove over arc lengths (...)."""
        return np.interp(np.asarray(s, np.float64), self.line.arc_lengths, self.speeds)

    def pose(self, s: ArrayLike, lateral: ArrayLike = 0.0) -> Array:
        """Poses (..., 3) at Frenet coordinates, heading along the route.

        Continued straight beyond the ends: callers that must stay on the recorded road compare s
        with `length`.
        """
        s, lateral = np.broadcast_arrays(np.asarray(s, np.float64), lateral)
        heading = self.heading(s)
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        xy = self.line.position(s) + lateral[..., None] * normal
        return np.concatenate([xy, heading[..., None]], axis=-1)

    def at_time(self, timestamp_us: ArrayLike) -> Array | None:
        """Arc lengths (...) that the log had reached at times; None for a route without times."""
        if self.seconds is None:
            return None
        times = np.asarray(timestamp_us, np.float64) * 1e-6
        return np.interp(times, self.seconds, self.line.arc_lengths)

    def follow(self, points: ArrayLike, near: float) -> Array:
        """Coordinates s (T,) of points (T, >=2) in the order of time: each near the one before.

        Args:
            near: the coordinate before the first one.
        """
        found, before = [], None
        for point in np.asarray(points, np.float64)[:, :2]:
            moved = 0.0 if before is None else float(np.linalg.norm(point - before))
            near, before = float(self.project(point, near, REACH + moved)[0]), point
            found.append(near)
        return np.array(found)

    @cached_property
    def cusps(self) -> Array:
        """Coordinates at which the drive turns back into itself: it began or ended to reverse."""
        s, span = self.line.arc_lengths, round(_CUSP_LENGTH / _SAMPLE_SPACING)
        turned = np.abs(self.headings[span:] - self.headings[:-span]) > _CUSP_TURN
        begins = np.flatnonzero(turned & ~np.append(False, turned[:-1]))
        return np.asarray(s[np.minimum(begins + span, len(s) - 1)])

    def project(
        self, points: ArrayLike, near: ArrayLike | None = None, reach: float = REACH
    ) -> tuple[Array, Array]:
        """Frenet coordinates s (...), lateral (...) of points (..., >=2).

        Unlike `Polyline.to_frenet`, s is negative before the start and exceeds `length` past the
        end, measured along the end tangents.

        Args:
            near, reach: coordinates (...) near which they are, see `Polyline.to_frenet`.
        """
        xy = np.asarray(points, np.float64)[..., :2]
        s, lateral = self.line.to_frenet(xy, near, reach)
        for end, beyond in ((0.0, s <= 0.0), (self.length, s >= self.length)):
            offset = xy - self.line.position(end)
            heading = float(self.line.heading(end))
            along = offset[..., 0] * np.cos(heading) + offset[..., 1] * np.sin(heading)
            across = offset[..., 1] * np.cos(heading) - offset[..., 0] * np.sin(heading)
            s = np.where(beyond, end + along, s)
            lateral = np.where(beyond, across, lateral)
        return s, lateral

    def command(self, pose: ArrayLike, near: float | None = None) -> DrivingCommand:
        """The driving command at a pose (>=2,), OpenScene's rule.

        `near` is as for `project`.

        From the route point beside the ego to the one 20 m on, seen in the frame of the first:
        2 m or more to a side is a turn. Less than 20 m from the end of the route, the end counts;
        off its ends the command is unknown.
        """
        s = float(self.project(pose, near)[0])
        if not 0.0 <= s <= self.length:
            return DrivingCommand.UNKNOWN
        here, ahead = self.pose(s), self.pose(min(s + _COMMAND_LOOKAHEAD, self.length))
        offset = float(se2.relative(here, ahead)[1])
        if offset >= _COMMAND_OFFSET:
            return DrivingCommand.LEFT
        if offset <= -_COMMAND_OFFSET:
            return DrivingCommand.RIGHT
        return DrivingCommand.STRAIGHT


def route_lanes(hdmap: HdMap, route: ReferenceRoute) -> tuple[Lane, ...]:
    """Lanes that the route drives on: within 2.5 m and 45 degrees of it, in its order.

    Where parallel lanes both qualify, the one nearer to the route comes first.
    """
    found: list[tuple[float, float, Lane]] = []
    for lane in hdmap.lanes.values():
        centreline = Polyline.from_points(lane.centreline)
        s, lateral = route.project(centreline.points)
        turn = se2.wrap_angle(centreline.heading(centreline.arc_lengths) - route.heading(s))
        near = (np.abs(lateral) <= _LANE_DISTANCE) & (np.abs(turn) <= _LANE_ANGLE)
        near &= (s >= 0.0) & (s <= route.length)
        if np.any(near):
            found.append((float(s[near].min()), float(np.abs(lateral[near]).mean()), lane))
    return tuple(lane for _, _, lane in sorted(found, key=lambda item: item[:2]))


def _knots(xy: Array) -> list[int]:
    """Indices of positions at least a knot spacing apart; the last one is the log's end."""
    points = xy.tolist()  # plain floats: ten times faster one by one than array rows
    knots = [0]
    for i, point in enumerate(points):
        if math.dist(point, points[knots[-1]]) >= _KNOT_SPACING:
            knots.append(i)
    last = len(points) - 1
    if knots[-1] != last and len(knots) > 1:
        # A knot too near to the end gives way to it: the route ends where the log does.
        if math.dist(points[last], points[knots[-1]]) <= _KNOT_SPACING / 2:
            knots.pop()
        knots.append(last)
    return knots
