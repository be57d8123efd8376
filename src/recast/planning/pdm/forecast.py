"""Where others will be, at constant velocity, every 0.2 s, and where simulated egos are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray
from recast.dynamics import VehicleParameters
from recast.geometry import boxes, se2
from recast.planning.map import PlannerMap
from recast.planning.types import ActorState

STRIDE = 2
"""Steps of 0.1 s between occupancy maps; step i reads map i // 2."""
RED_LIGHT = "red_light_"


class Kind(Enum):
    """What an obstacle is, as far as PDM cares; the value is how many of them count at most."""

    VEHICLE = ("vehicle", 50)
    PEDESTRIAN = ("pedestrian", 25)
    BICYCLE = ("bicycle", 10)
    STATIC = ("static", 50)
    RED_LIGHT = ("red light", None)

    @property
    def moves(self) -> bool:
        """Whether it is a road user."""
        return self in (Kind.VEHICLE, Kind.PEDESTRIAN, Kind.BICYCLE)


@dataclass(frozen=True)
class Obstacle:
    """One road user or static object now.

    Attributes:
        kind: not `RED_LIGHT`.
        pose: (3,) x, y, heading of the box centre, world.
        velocity: (2,) m/s, world.
        size: (2,) length, width in metres.
    """

    token: str
    kind: Kind
    pose: Array
    velocity: Array
    size: Array

    @classmethod
    def from_actor(cls, actor: ActorState) -> Obstacle:
        """The obstacle of an actor; categories that are neither person nor cycle are vehicles."""
        kinds = {"pedestrian": Kind.PEDESTRIAN, "cyclist": Kind.BICYCLE}
        kind = kinds.get(actor.category, Kind.VEHICLE)
        return cls(actor.track_id, kind, actor.pose, actor.velocity, actor.size[:2])

    @property
    def speed(self) -> float:
        """Metres per second; 0 for static objects."""
        return float(np.hypot(*self.velocity)) if self.kind.moves else 0.0

    @property
    def drift(self) -> Array:
        """Velocity (2,) of the forecast: the speed along the box's heading.

        Against it where the velocity points backwards.
        """
        if self.speed == 0.0:
            return np.zeros(2)
        course = np.arctan2(self.velocity[1], self.velocity[0])
        forward = abs(float(se2.wrap_angle(self.pose[2] - course))) < np.pi / 2
        heading = self.pose[2] if forward else self.pose[2] + np.pi
        return self.speed * np.array([np.cos(heading), np.sin(heading)])


@dataclass(frozen=True)
class Forecast:
    """Polygons of n obstacles over the coming steps.

    Attributes:
        headings: (n,) now; 0 for red lights.
        speeds: (n,) m/s, 0 for what stands.
        polygons: (maps, n) shapely polygons.
        ignored: (n,) obstacles the ego has touched: nothing can be done about them any more.
    """

    tokens: tuple[str, ...]
    kinds: tuple[Kind, ...]
    headings: Array
    speeds: Array
    polygons: NDArray[np.object_]
    ignored: NDArray[np.bool_]

    @cached_property
    def _trees(self) -> list[shapely.STRtree]:
        return [shapely.STRtree(row) for row in self.polygons]

    def at(self, step: int) -> NDArray[np.object_]:
        """The polygons (n,) at a step."""
        return self.polygons[step // STRIDE]

    def touching(self, step: int, shapes: NDArray[np.object_]) -> list[tuple[int, int]]:
        """Pairs (index of shape, index of obstacle) that meet at a step; shapes in order."""
        rows, columns = self._trees[step // STRIDE].query(shapes, predicate="intersects")
        return sorted(zip(rows.tolist(), columns.tolist(), strict=True))


def forecast(
    obstacles: Iterable[Obstacle],
    red_lights: Sequence[tuple[str, shapely.Polygon]],
    centre: ArrayLike,
    ego: shapely.Polygon,
    collided: set[str],
    *,
    steps: int,
    dt: float,
    radius: float,
) -> Forecast:
    """Forecast obstacles at constant velocity.

    What overlaps the ego now is added to `collided`, a red light only if it holds the whole ego.

    Args:
        obstacles: road users and static objects; those within `radius` of the centre count, of
            each kind the nearest ones.
        red_lights: lane id and polygon of closed connectors on the route.
        centre: (>=2,) of the ego's box.
        collided: ids touched so far, which are left out; grows.
        steps: of `dt` seconds, covered at least.
    """
    chosen = _nearest(obstacles, np.asarray(centre, np.float64)[:2], collided, radius)
    count = len(chosen)
    times = dt * STRIDE * np.arange(-(-steps // STRIDE) + 1)
    polygons = np.empty((len(times), count + len(red_lights)), np.object_)
    if count:
        corners = np.stack([boxes.bev_corners(o.pose, o.size[0], o.size[1]) for o in chosen])
        drift = np.stack([o.drift for o in chosen])
        moved = corners + times[:, None, None, None] * drift[:, None, :]
        polygons[:, :count] = shapely.polygons(moved)
    for i, (_, polygon) in enumerate(red_lights):
        polygons[:, count + i] = polygon
    tokens = (*(o.token for o in chosen), *(RED_LIGHT + lane for lane, _ in red_lights))
    kinds = (*(o.kind for o in chosen), *(Kind.RED_LIGHT for _ in red_lights))
    ignored = np.zeros(len(tokens), np.bool_)
    for i, (token, kind) in enumerate(zip(tokens, kinds, strict=True)):
        shape = polygons[0, i]
        red = kind is Kind.RED_LIGHT
        touched = shapely.within(ego, shape) if red else shapely.intersects(ego, shape)
        ignored[i] = touched or token in collided
    collided.update(token for token, gone in zip(tokens, ignored, strict=True) if gone)
    zeros = np.zeros(len(red_lights))
    return Forecast(
        tokens,
        kinds,
        np.array([*(float(o.pose[2]) for o in chosen), *zeros]),
        np.array([*(o.speed for o in chosen), *zeros]),
        polygons,
        ignored,
    )


def _nearest(
    obstacles: Iterable[Obstacle], centre: Array, collided: set[str], radius: float
) -> list[Obstacle]:
    """Static objects first, then the others, by kind and distance."""
    near: dict[Kind, list[tuple[float, Obstacle]]] = {
        kind: [] for kind in (Kind.STATIC, Kind.VEHICLE, Kind.PEDESTRIAN, Kind.BICYCLE)
    }
    for obstacle in obstacles:
        distance = float(np.linalg.norm(obstacle.pose[:2] - centre))
        if distance <= radius and obstacle.token not in collided:
            near[obstacle.kind].append((distance, obstacle))
    return [
        obstacle
        for kind, found in near.items()
        for _, obstacle in sorted(found, key=lambda item: item[0])[: kind.value[1]]
    ]


def box_centres(poses: ArrayLike, vehicle: VehicleParameters) -> Array:
    """Centres (..., 3), headings included, of the boxes of rear-axle poses (..., 3)."""
    return se2.compose(poses, np.array([vehicle.centre_offset, 0.0, 0.0]))


def box_corners(poses: ArrayLike, vehicle: VehicleParameters) -> Array:
    """Corners (..., 4, 2) front left, rear left, rear right, front right of rear-axle poses."""
    return boxes.bev_corners(box_centres(poses, vehicle), vehicle.length, vehicle.width)


def outline(pose: ArrayLike, vehicle: VehicleParameters) -> shapely.Polygon:
    """The box of one rear-axle pose (3,) as a polygon."""
    return shapely.Polygon(box_corners(pose, vehicle))


@dataclass(frozen=True)
class EgoAreas:
    """Flags (...) of ego boxes.

    Attributes:
        multiple_lanes: more than one lane holds a corner, and none holds all four.
        non_drivable: some corner lies in no drivable polygon.
        oncoming: the centre lies in no lane of the route.
        in_intersection: the rear axle lies inside an intersection.
    """

    multiple_lanes: BoolArray
    non_drivable: BoolArray
    oncoming: BoolArray
    in_intersection: BoolArray

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
) -> EgoAreas:
    """Flags of ego boxes; a point on a polygon's edge is outside it.

    Args:
        corners: (..., 4, 2) of the boxes.
        centres: (..., >=2) of the boxes.
        rear_axles: (..., >=2).
    """
    corners = np.asarray(corners, np.float64)
    centres = np.asarray(centres, np.float64)[..., None, :2]
    shape = corners.shape[:-2]
    on_route = set(route_lanes)
    drivable = planner_map.drivable_hits(corners)
    touched = np.zeros(shape, np.int64)
    whole, with_route = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for lane, hits in planner_map.lane_hits(np.concatenate([corners, centres], axis=-2)).items():
        of_corners = hits[..., :4]
        drivable |= of_corners
        touched += of_corners.any(axis=-1)
        whole |= of_corners.all(axis=-1)
        if lane in on_route:
            with_route |= hits[..., 4]
    return EgoAreas(
        multiple_lanes=np.asarray((touched > 1) & ~whole),
        non_drivable=np.asarray(~drivable.all(axis=-1)),
        oncoming=~with_route,
        in_intersection=planner_map.in_intersection(np.asarray(rear_axles, np.float64)[..., :2]),
    )
