"""What is refused at the start: a route off the map, an actor off the road or inside the ego."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import boxes
from recast.logs.drivable_region import drivable_region
from recast.logs.hdmap import HdMap
from recast.planning import ReferenceRoute

Array = NDArray[np.float64]

ON_ROAD = 0.5
"""Share of the actor's box that must lie on the drivable area."""
_ROUTE_ON_MAP = 0.5
_TOLERANCE = 0.3
"""Metres beside the drivable area that still count as on the map, as in the metric DAC."""
_TOUCHING = 1e-9


def refuse_overlap(
    where: str, rollout: str, ego: Array, ego_size: Array, actor: Array, actor_size: Array
) -> None:
    """Refuse an actor that stands in the ego.

    Args:
        where, rollout: names for the error.
        ego, actor: (3,) x, y, heading of the box centres.
        ego_size, actor_size: (>=2,) length and width, metres.

    Raises:
        InputError: the boxes overlap.
    """
    overlap = boxes.bev_overlap_area(ego, ego_size, actor, actor_size)
    if overlap > _TOUCHING:
        raise InputError(
            where,
            rollout,
            f"actor and ego overlap by {overlap:.2f} m2 at the start",
            "choose another start, motion or setting",
        )


def surveyed_road(hdmap: HdMap | None) -> shapely.Geometry | None:
    """Drivable area and lanes of a surveyed map; None without one.

    A derived map is made from the drive and ends where the drive saw nothing: nothing is refused
    by it.
    """
    region = None if hdmap is None or hdmap.derived else drivable_region(hdmap)
    if region is not None:
        shapely.prepare(region)
    return region


def refuse_off_map(
    where: str,
    rollout: str,
    road: shapely.Geometry | None,
    route: ReferenceRoute,
    start: float,
) -> None:
    """Refuse a map that is not of this drive.

    Args:
        where, rollout: names for the error.
        road: from `surveyed_road`; None refuses nothing.
        start: route coordinate from which the route is looked at, metres.

    Raises:
        InputError: less than half of what is left of the route lies on the map.
    """
    if road is None:
        return
    s = np.linspace(min(start, route.length), route.length, 200)
    distance = shapely.distance(road, shapely.points(route.line.position(s)))
    share = float(np.mean(distance <= _TOLERANCE))
    if share < _ROUTE_ON_MAP:
        raise InputError(
            where,
            rollout,
            f"only {share:.0%} of the ego's route lies on the map",
            "check that the map is of this drive and in its world frame",
        )


def refuse_off_road(
    where: str, rollout: str, road: shapely.Geometry | None, actor: Array, actor_size: Array
) -> None:
    """Refuse an actor that stands beside the road.

    Args:
        where, rollout: names for the error.
        road: from `surveyed_road`; None refuses nothing.
        actor: (3,) x, y, heading of its box centre at the start.
        actor_size: (>=2,) length and width, metres.

    Raises:
        InputError: less than half of its box lies on the drivable area.
    """
    share = float(on_road_shares(road, actor, actor_size))
    if share < ON_ROAD:
        raise InputError(
            where,
            rollout,
            f"the actor would start off the road: {share:.0%} of its box lies on the drivable area",
            "choose another start, motion or setting",
        )


def on_road_shares(road: shapely.Geometry | None, actor: Array, actor_size: Array) -> Array:
    """Share (...) of boxes (..., 3) that lies on the road; 1 where that is None."""
    if road is None:
        return np.ones(actor.shape[:-1])
    outlines = shapely.polygons(boxes.bev_corners(actor, actor_size[0], actor_size[1]))
    covered: Array = shapely.area(shapely.intersection(outlines, road))
    return covered / shapely.area(outlines)
