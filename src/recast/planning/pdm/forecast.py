"""Where others will be: at constant velocity every 0.2 s, or as observed; and the ego's boxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray, Int64Array
from recast.dynamics import VehicleParameters
from recast.geometry import boxes, se2
from recast.planning.types import ActorState

STRIDE = 2
"""Steps of 0.1 s between PDM-Closed's occupancy maps; step i reads map i // 2."""
RED_LIGHT = "red_light_"


class AgentKind(Enum):
    """What an obstacle is, as far as PDM cares; the value is how many of them count at most."""

    VEHICLE = ("vehicle", 50)
    PEDESTRIAN = ("pedestrian", 25)
    BICYCLE = ("bicycle", 10)
    STATIC = ("static", 50)
    RED_LIGHT = ("red light", None)

    @property
    def moves(self) -> bool:
        """Whether it is a road user."""
        return self in (AgentKind.VEHICLE, AgentKind.PEDESTRIAN, AgentKind.BICYCLE)


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
    kind: AgentKind
    pose: Array
    velocity: Array
    size: Array

    @classmethod
    def from_actor(cls, actor: ActorState) -> Obstacle:
        """The obstacle of an actor; categories that are neither person nor cycle are vehicles."""
        kinds = {"pedestrian": AgentKind.PEDESTRIAN}
        kinds |= dict.fromkeys(("cyclist", "motorcyclist"), AgentKind.BICYCLE)  # as in nuPlan
        kind = kinds.get(actor.category, AgentKind.VEHICLE)
        return cls(actor.track_id, kind, actor.pose, actor.velocity, actor.size[:2])

    @property
    def speed(self) -> float:
        """Metres per second; 0 for static objects."""
        return float(np.hypot(*self.velocity)) if self.kind.moves else 0.0


@dataclass(frozen=True)
class Forecast:
    """Polygons of n obstacles over the coming steps.

    Attributes:
        headings: (n,) headings now; 0 for red lights.
        speeds: (n,) m/s, 0 for what stands.
        polygons: (maps, n) shapely polygons.
        ignored: (n,) obstacles the ego has touched: nothing can be done about them any more.
        stride: steps between two maps.
    """

    tokens: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    headings: Array
    speeds: Array
    polygons: NDArray[np.object_]
    ignored: NDArray[np.bool_]
    stride: int = STRIDE

    @cached_property
    def red(self) -> BoolArray:
        """(n,) which are red lights."""
        return np.array([kind is AgentKind.RED_LIGHT for kind in self.kinds], np.bool_)

    def at(self, step: int) -> NDArray[np.object_]:
        """The polygons (n,) at a step."""
        return self.polygons[step // self.stride]

    def first_contacts(self, corners: Array, steps: Int64Array, counted: BoolArray) -> Int64Array:
        """Index (P, n) of the first look at which a box meets an obstacle; L where none does.

        Ignored obstacles and red lights are met by nobody.

        Args:
            corners: (P, L, 4, 2) corners of P boxes at L looks.
            steps: (L,) steps of the forecast, one for each look.
            counted: (P, L) looks that count.
        """
        looks, maps = corners.shape[1], steps // self.stride
        shapes = np.flatnonzero(~(self.ignored | self.red))
        found = np.full((len(corners), len(self.tokens)), looks)
        # In the order of box, obstacle, look.
        left, bottom, right, top = shapely.bounds(self.polygons[:, shapes]).T[:, :, maps]
        low, high = corners.min(axis=2)[:, None], corners.max(axis=2)[:, None]
        near = (low[..., 0] <= right) & (high[..., 0] >= left)
        near &= (low[..., 1] <= top) & (high[..., 1] >= bottom)
        near &= counted[:, None]
        p, i, look = np.nonzero(near)
        k = shapes[i]
        # Exact tests are dear, and only the first hit of each pair is wanted: ever more looks at a
        # time, until all pairs have met or have none left.
        pair = p * len(self.tokens) + k
        rank = np.arange(len(pair)) - np.searchsorted(pair, pair)
        begin, count = 0, 1
        while begin <= rank.max(initial=-1):
            tried = (begin <= rank) & (rank < begin + count) & (found[p, k] == looks)
            at = np.flatnonzero(tried)
            boxes_then = shapely.polygons(corners[p[at], look[at]])
            met = at[shapely.intersects(boxes_then, self.polygons[maps[look[at]], k[at]])]
            np.minimum.at(found, (p[met], k[met]), look[met])
            begin, count = begin + count, 2 * count
        return found


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
        centre: (>=2,) centre of the ego's box.
        collided: ids of obstacles touched so far, which are left out; grows.
        steps: number of steps of `dt` seconds that are covered at least.
    """
    chosen = _nearest(obstacles, np.asarray(centre, np.float64)[:2], collided, radius)
    count = len(chosen)
    times = dt * STRIDE * np.arange(-(-steps // STRIDE) + 1)
    polygons = np.empty((len(times), count + len(red_lights)), np.object_)
    zeros = [0.0] * len(red_lights)
    speeds = np.array([*(o.speed for o in chosen), *zeros])
    if count:
        poses = np.stack([o.pose for o in chosen])
        length, width = np.array([o.size[:2] for o in chosen]).T
        drift = _drift(poses[:, 2], np.stack([o.velocity for o in chosen]), speeds[:count])
        corners = boxes.bev_corners(poses, length, width)
        moved = corners + times[:, None, None, None] * drift[:, None, :]
        polygons[:, :count] = shapely.polygons(moved)
    for i, (_, polygon) in enumerate(red_lights):
        polygons[:, count + i] = polygon
    tokens = (*(o.token for o in chosen), *(RED_LIGHT + lane for lane, _ in red_lights))
    kinds = (*(o.kind for o in chosen), *(AgentKind.RED_LIGHT for _ in red_lights))
    known = np.array([token in collided for token in tokens], np.bool_)
    ignored = known | shapely.intersects(ego, polygons[0])
    ignored[count:] = known[count:] | shapely.within(ego, polygons[0, count:])
    collided.update(token for token, gone in zip(tokens, ignored, strict=True) if gone)
    headings = np.array([*(float(o.pose[2]) for o in chosen), *zeros])
    return Forecast(tokens, kinds, headings, speeds, polygons, ignored)


def observed(
    obstacles: Sequence[Obstacle],
    poses: ArrayLike,
    red_lights: Sequence[tuple[str, shapely.Polygon, BoolArray]] = (),
) -> Forecast:
    """The forecast of obstacles whose poses are known at every step; none is ignored.

    Args:
        obstacles: n obstacles at the first step.
        poses: (n, T, 3) x, y, heading of their box centres; NaN while they are not there.
        red_lights: lane id, polygon, and (T,) whether the light is red, of connectors on the route.
    """
    poses = np.asarray(poses, np.float64)
    count, steps = len(obstacles), poses.shape[1]
    polygons = np.full((steps, count + len(red_lights)), shapely.Polygon(), np.object_)
    if count:
        length, width = np.array([o.size[:2] for o in obstacles]).T
        there = ~np.isnan(poses).any(axis=-1)
        corners = boxes.bev_corners(poses, length[:, None], width[:, None])
        polygons[:, :count][there.T] = shapely.polygons(corners.swapaxes(0, 1)[there.T])
    for i, (_, polygon, red) in enumerate(red_lights):
        polygons[red, count + i] = polygon
    zeros = [0.0] * len(red_lights)
    return Forecast(
        (*(o.token for o in obstacles), *(RED_LIGHT + lane for lane, _, _ in red_lights)),
        (*(o.kind for o in obstacles), *(AgentKind.RED_LIGHT for _ in red_lights)),
        np.array([*(float(o.pose[2]) for o in obstacles), *zeros]),
        np.array([*(o.speed for o in obstacles), *zeros]),
        polygons,
        np.zeros(count + len(red_lights), np.bool_),
        stride=1,
    )


def _drift(headings: Array, velocities: Array, speeds: Array) -> Array:
    """Velocities (n, 2) of the forecast: the speed along the box's heading.

    Against it where the velocity points backwards.

    Args:
        headings: (n,) headings now.
        velocities: (n, 2) velocities now.
        speeds: (n,) speeds now; 0 for what stands.
    """
    course = np.arctan2(velocities[:, 1], velocities[:, 0])
    forward = np.abs(se2.wrap_angle(headings - course)) < np.pi / 2
    heading = np.where(forward, headings, headings + np.pi)
    return speeds[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def _nearest(
    obstacles: Iterable[Obstacle], centre: Array, collided: set[str], radius: float
) -> list[Obstacle]:
    """Static objects first, then the others, by kind and distance."""
    near: dict[AgentKind, list[tuple[float, Obstacle]]] = {
        kind: []
        for kind in (AgentKind.STATIC, AgentKind.VEHICLE, AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
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
