"""Lanes and drivable area, in the log's world frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lane:
    """One lane segment.

    Attributes:
        lane_id: unique in the map.
        centreline, left_boundary, right_boundary: (N, 3) metres, in driving direction.
        polygon: (M, 2) counter-clockwise outline.
        speed_limit: m/s, or None where unknown.
        successors: lanes one can drive on into.
        left_neighbour, right_neighbour: adjacent lane of the same direction, or None.
        is_intersection: inside a junction.
    """

    lane_id: str
    centreline: Array
    left_boundary: Array
    right_boundary: Array
    polygon: Array
    speed_limit: float | None = None
    successors: tuple[str, ...] = ()
    left_neighbour: str | None = None
    right_neighbour: str | None = None
    is_intersection: bool = False


@dataclass(frozen=True)
class GroundHeight:
    """Ground height on a regular grid.

    Attributes:
        origin: (2,) x, y of the centre of cell [0, 0], metres.
        cell: metres.
        height: (rows along y, columns along x) float64, NaN where unknown.
    """

    origin: Array
    cell: float
    height: Array

    def at(self, points: Array) -> Array:
        """Heights (...) under points (..., 2), nearest cell; NaN outside or where unknown."""
        index = np.rint((np.asarray(points, np.float64) - self.origin) / self.cell).astype(int)
        col, row = index[..., 0], index[..., 1]
        rows, cols = self.height.shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        heights: Array = np.where(
            inside, self.height[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)], np.nan
        )
        return heights


@dataclass(frozen=True)
class HdMap:
    """Lanes and drivable area.

    Attributes:
        lanes: by id.
        drivable_area: outlines (N, 2); where they overlap, each still counts (a union).
        ground: ground height, or None.
        derived: True where made from the drive itself, not surveyed.
    """

    lanes: Mapping[str, Lane]
    drivable_area: tuple[Array, ...]
    ground: GroundHeight | None = None
    derived: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)

    def validate(self) -> None:
        """Raise ValueError naming the lane and field at fault."""
        for key, lane in self.lanes.items():
            where = f"HdMap.lanes[{key!r}]"
            if lane.lane_id != key:
                raise ValueError(f"{where}.lane_id: is {lane.lane_id!r}")
            for name in ("centreline", "left_boundary", "right_boundary"):
                line = getattr(lane, name)
                if line.ndim != 2 or line.shape[1] != 3 or len(line) < 2:
                    raise ValueError(f"{where}.{name}: expected (N >= 2, 3), got {line.shape}")
            if lane.polygon.ndim != 2 or lane.polygon.shape[1] != 2 or len(lane.polygon) < 3:
                raise ValueError(f"{where}.polygon: expected (N >= 3, 2), got {lane.polygon.shape}")
            linked = (*lane.successors, lane.left_neighbour, lane.right_neighbour)
            for other in linked:
                if other is not None and other not in self.lanes:
                    raise ValueError(f"{where}: names lane {other!r}, which the map lacks")
        for i, outline in enumerate(self.drivable_area):
            if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
                raise ValueError(
                    f"HdMap.drivable_area[{i}]: expected (N >= 3, 2), got {outline.shape}"
                )
