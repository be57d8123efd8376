"""A path of poses, measured along its chords."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.ops import substring

from recast.geometry import se2

Array = NDArray[np.float64]

_START = 1e-5


class LanePath:
    """Poses joined by straight chords; unlike `Polyline`, neighbours may be equal.

    They are where a lane ends and the next one begins.

    Args:
        poses: (N, 3) x, y, heading; N >= 2.
    """

    def __init__(self, poses: ArrayLike) -> None:
        self.poses = np.array(poses, np.float64)
        self.poses[:, 2] = np.unwrap(self.poses[:, 2])
        steps = np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1)
        self.progress = np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """Metres from end to end."""
        return float(self.progress[-1])

    @cached_property
    def line(self) -> shapely.LineString:
        """The chords as a shapely line."""
        line = shapely.LineString(self.poses[:, :2])
        shapely.prepare(line)
        return line

    def at(self, progress: ArrayLike) -> Array:
        """Poses (..., 3) at progress (...) in metres, which is limited to [1e-5, length]."""
        s = np.clip(np.asarray(progress, np.float64), _START, self.length)
        x, y, heading = (np.interp(s, self.progress, self.poses[:, k]) for k in range(3))
        return np.stack([x, y, se2.wrap_angle(heading)], axis=-1)

    def project(self, points: ArrayLike) -> Array:
        """Progress (...) in metres of the path points nearest to points (..., >=2)."""
        points = shapely.points(np.asarray(points, np.float64)[..., :2])
        return np.asarray(shapely.line_locate_point(self.line, points), np.float64)

    def stretch(self, start: float, end: float, *, vertices_only: bool) -> shapely.Geometry:
        """The part between two progress values, as a line (or a point where it has no length).

        Args:
            start, end: metres, limited to the path.
            vertices_only: leave out the pieces between the ends and the nearest vertices inside,
                unless fewer than two vertices remain (tuplan_garage).
        """
        start, end = np.clip([start, end], 0.0, self.length)
        inside = (start <= self.progress) & (self.progress <= end)
        if vertices_only and np.count_nonzero(inside) >= 2:
            return shapely.LineString(self.poses[inside, :2])
        return substring(self.line, start, end)

    def shifted(self, offset: float) -> LanePath:
        """The parallel path `offset` metres to the left; every pose keeps its heading."""
        moved = self.poses.copy()
        moved[:, 0] += offset * np.cos(moved[:, 2] + np.pi / 2)
        moved[:, 1] += offset * np.sin(moved[:, 2] + np.pi / 2)
        return LanePath(moved)
