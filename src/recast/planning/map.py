"""The map as planners query it: lanes, blocks, areas, and what may be driven on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray


@dataclass(frozen=True)
class PlannerLane:
    """One lane or, inside an intersection, one connector.

    Attributes:
        centreline: (N, 3) x, y, heading in driving direction, at most 0.5 m apart, N >= 2.
        polygon: outline in the plane; a shapely polygon or multi-polygon.
        speed_limit: speed limit in m/s, or None where unknown.
        successors: lanes one can drive on into.
        connector: whether it lies inside an intersection.
    """

    lane_id: str
    block_id: str
    centreline: Array
    polygon: shapely.Geometry
    speed_limit: float | None = None
    successors: tuple[str, ...] = ()
    connector: bool = False

    @cached_property
    def length(self) -> float:
        """Metres along the centreline."""
        steps = np.diff(self.centreline[:, :2], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True)
class Block:
    """Lanes side by side in one direction: nuPlan's roadblock.

    Attributes:
        connector: whether it lies inside an intersection.
        successors, predecessors: blocks that its lanes lead into and come from.
    """

    block_id: str
    lane_ids: tuple[str, ...]
    connector: bool
    successors: tuple[str, ...] = ()
    predecessors: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannerMap:
    """What a planner may ask of a map; world frame, metres.

    Attributes:
        lanes: lanes by id, connectors included.
        drivable: further polygons that may be driven on, beside the lanes.
        intersections: polygons, by which a planner knows that it is in one.
        car_parks: polygons, which may be driven on too.
    """

    lanes: Mapping[str, PlannerLane]
    drivable: Sequence[shapely.Geometry] = ()
    intersections: Sequence[shapely.Geometry] = ()
    car_parks: Sequence[shapely.Geometry] = ()

    def __post_init__(self) -> None:
        lanes = [lane.polygon for lane in self.lanes.values()]
        shapely.prepare([*lanes, *self._other, *self.intersections])

    @cached_property
    def blocks(self) -> Mapping[str, Block]:
        """Blocks by id, in the order of their first lanes."""
        members: dict[str, list[str]] = {}
        for lane in self.lanes.values():
            members.setdefault(lane.block_id, []).append(lane.lane_id)
        after: dict[str, dict[str, None]] = {block: {} for block in members}
        before: dict[str, dict[str, None]] = {block: {} for block in members}
        for lane in self.lanes.values():
            for key in lane.successors:
                other = self.lanes[key].block_id
                if other != lane.block_id:
                    after[lane.block_id][other] = None
                    before[other][lane.block_id] = None
        return {
            key: Block(
                key,
                tuple(lanes),
                all(self.lanes[lane].connector for lane in lanes),
                tuple(after[key]),
                tuple(before[key]),
            )
            for key, lanes in members.items()
        }

    def lanes_of(self, blocks: Iterable[str]) -> tuple[str, ...]:
        """Ids of all lanes in some blocks, block by block."""
        return tuple(lane for block in blocks for lane in self.blocks[block].lane_ids)

    def lanes_at(self, point: ArrayLike, reach: float = 0.0) -> tuple[str, ...]:
        """Ids of lanes whose polygon comes within `reach` metres of a point (>=2,), in map order.

        With no reach, those that hold or touch it.
        """
        found = self._lane_tree.query(_point(point), predicate="dwithin", distance=reach)
        return tuple(self._lane_ids[i] for i in np.sort(found))

    def near(self, point: ArrayLike, radius: float) -> PlannerMap:
        """The part of the map whose polygons come within `radius` metres of a point (>=2,)."""
        centre = _point(point)

        def close(polygons: Sequence[shapely.Geometry]) -> tuple[shapely.Geometry, ...]:
            return tuple(p for p in polygons if shapely.dwithin(p, centre, radius))

        kept = {k: v for k, v in self.lanes.items() if shapely.dwithin(v.polygon, centre, radius)}
        reduced = {
            key: replace(lane, successors=tuple(k for k in lane.successors if k in kept))
            for key, lane in kept.items()
        }
        return PlannerMap(
            reduced, close(self.drivable), close(self.intersections), close(self.car_parks)
        )

    def lane_hits(self, points: ArrayLike) -> dict[str, BoolArray]:
        """By lane id, which points (..., 2) lie strictly inside it; lanes without any left out."""
        polygons = [lane.polygon for lane in self.lanes.values()]
        return {
            self._lane_ids[i]: inside
            for i, inside in _hits(polygons, self._lane_tree, np.asarray(points, np.float64))
        }

    def car_park_hits(self, points: ArrayLike) -> list[BoolArray]:
        """For each car park that holds some, which points (..., 2) lie strictly inside it."""
        hits = _hits(self._other, self._other_tree, np.asarray(points, np.float64))
        return [inside for i, inside in hits if i < len(self.car_parks)]

    def drivable_hits(self, points: ArrayLike) -> BoolArray:
        """Which points (..., 2) lie strictly inside a drivable polygon that is no lane.

        Car parks and the drivable area count; intersections do only by the lanes in them.
        """
        points = np.asarray(points, np.float64)
        found = np.zeros(points.shape[:-1], np.bool_)
        for _, inside in _hits(self._other, self._other_tree, points):
            found |= inside
        return found

    def in_intersection(self, points: ArrayLike) -> BoolArray:
        """Which points (..., 2) lie inside an intersection."""
        points = np.asarray(points, np.float64)
        found = np.zeros(points.shape[:-1], np.bool_)
        for polygon in self.intersections:
            found |= np.asarray(shapely.contains_xy(polygon, points[..., 0], points[..., 1]))
        return found

    @cached_property
    def _lane_ids(self) -> tuple[str, ...]:
        return tuple(self.lanes)

    @cached_property
    def _other(self) -> list[shapely.Geometry]:
        return [*self.car_parks, *self.drivable]

    @cached_property
    def _lane_tree(self) -> shapely.STRtree:
        return shapely.STRtree([lane.polygon for lane in self.lanes.values()])

    @cached_property
    def _other_tree(self) -> shapely.STRtree:
        return shapely.STRtree(self._other)


def _hits(
    polygons: Sequence[shapely.Geometry], tree: shapely.STRtree, points: Array
) -> list[tuple[int, BoolArray]]:
    flat = points.reshape(-1, 2)
    bounds = shapely.box(*flat.min(axis=0), *flat.max(axis=0))
    found = []
    for i in np.sort(tree.query(bounds)):
        inside = np.asarray(shapely.contains_xy(polygons[i], points[..., 0], points[..., 1]))
        if inside.any():
            found.append((int(i), inside))
    return found


def _point(point: ArrayLike) -> shapely.Point:
    x, y = np.asarray(point, np.float64)[:2]
    return shapely.Point(x, y)
