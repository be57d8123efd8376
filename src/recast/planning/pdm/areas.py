"""Where simulated egos are: across lanes, off the road, off the route, in an intersection."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import BoolArray
from recast.planning.map import PlannerMap


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
