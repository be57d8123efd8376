"""People: who they are, and where they walk and ride: on the pavement, across the road, along it.

They heed nobody and nobody heeds them, so that the traffic is the same with and without them: a way
on which anybody would be touched is not taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d

from recast.arrays import Array
from recast.synthetic.gaits import PersonLook, Ride, Walk, moving_model
from recast.synthetic.surface import Surface
from recast.synthetic.traffic import PlacedVehicle, TrafficScene, is_seen
from recast.synthetic.world import VehicleModel

_SLICES = (0.35, 0.9, 1.5)
"""Heights at which the street is cut: what is met there is in a person's way."""
_STEP = 0.4
"""Metres above the road below which something is ground."""
_ALONG, _ACROSS, _RIDING = (3, 4), (1, 2), (1, 2)
"""How many, at least and at most."""
_TRIES = 150
_WALKING, _CYCLING = (1.0, 1.6), (3.5, 6.0)
_PAVEMENT = (0.5, 2.2)
"""Metres from the edge of the road."""
_ROAD_EDGE = (0.6, 2.4)
_ROAD_SEARCH = 30.0
_BODY_ROOM, _OTHERS_ROOM = 0.4, 0.5
_SEEN = (28.0, np.deg2rad(60), 0.2)
_KERB_STEPS = 3
"""Poses over which a step up or down is spread (standard deviation)."""
_SKIN = ((0.6, 0.4, 0.3), (0.48, 0.3, 0.21), (0.32, 0.18, 0.11), (0.16, 0.09, 0.06))
_HAIR = ((0.03, 0.02, 0.015), (0.1, 0.05, 0.02), (0.3, 0.2, 0.08), (0.35, 0.34, 0.33))
_CLOTHES = {
    "red": (0.45, 0.03, 0.03),
    "blue": (0.04, 0.1, 0.4),
    "navy": (0.015, 0.025, 0.09),
    "green": (0.05, 0.22, 0.06),
    "yellow": (0.65, 0.45, 0.04),
    "white": (0.68, 0.68, 0.66),
    "grey": (0.2, 0.2, 0.21),
    "black": (0.02, 0.02, 0.02),
    "beige": (0.45, 0.36, 0.22),
    "purple": (0.2, 0.05, 0.25),
    "orange": (0.6, 0.18, 0.02),
}
_TROUSERS = ("navy", "black", "grey", "beige", "blue", "white")
_SHOES = ("black", "white", "red", "beige")
_CHILDREN, _PACKS = 0.2, 0.35


class Footing:
    """The street's triangles, asked for their height and for what stands in the way."""

    def __init__(self, surface: Surface) -> None:
        corners = surface.vertices[surface.faces]
        low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
        flat = corners[(high < _STEP) & (low > -_STEP)]
        turn = _cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
        self._ground, self._turn = flat[turn > 1e-9], turn[turn > 1e-9]
        self._low = self._ground[..., :2].min(axis=1)
        self._high = self._ground[..., :2].max(axis=1)
        cuts = [_cut(corners[(low < z) & (high > z)], z) for z in _SLICES]
        self._walls = shapely.STRtree(shapely.linestrings(np.concatenate(cuts)))

    def heights(self, points: Array) -> Array:
        """Height (N,) of the highest ground under points (N, 2); NaN where there is none."""
        near = np.all((self._low <= points.max(axis=0)) & (self._high >= points.min(axis=0)), 1)
        a, b, c = np.moveaxis(self._ground[near], 1, 0)
        if not len(a):
            return np.full(len(points), np.nan)
        turn, place = self._turn[near], points[:, None]
        # Barycentric weights (N, triangles) of the corners.
        u = _cross(c[:, :2] - b[:, :2], place - b[:, :2]) / turn
        v = _cross(a[:, :2] - c[:, :2], place - c[:, :2]) / turn
        w = 1 - u - v
        z = u * a[:, 2] + v * b[:, 2] + w * c[:, 2]
        inside = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9)
        highest = np.where(inside, z, -np.inf).max(axis=1)
        return np.where(np.isfinite(highest), highest, np.nan)

    def blocked(self, points: Array, room: float) -> bool:
        """Whether anything stands within `room` metres of a way along points (N, 2)."""
        way = shapely.linestrings(points)
        return len(self._walls.query(way, predicate="dwithin", distance=room)) > 0


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _cut(triangles: Array, z: float) -> Array:
    """Segments (N, 2, 2) in which triangles (N, 3, 3) that reach above and below z meet it."""
    above = triangles[..., 2] > z
    # The corner that is alone on its side, and the two others.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(triangles))
    apex = triangles[rows, alone]
    ends = []
    for k in (1, 2):
        other = triangles[rows, (alone + k) % 3]
        share = (z - apex[:, 2]) / (other[:, 2] - apex[:, 2])
        ends.append(apex[:, :2] + share[:, None] * (other[:, :2] - apex[:, :2]))
    return np.stack(ends, axis=1)


@dataclass(frozen=True)
class PlacedPerson:
    """A person with its poses."""

    placed: PlacedVehicle  # planar poses
    ground: Array  # (T,) height of the ground under it


def place_people(
    scene: TrafficScene, others: Sequence[PlacedVehicle], rng: np.random.Generator
) -> dict[str, PlacedPerson]:
    """Pedestrians and cyclists that the ego passes, by track id.

    Args:
        others: vehicles that nobody may touch, besides the ego and the target.
    """
    streets = _Streets(scene)
    wanted: tuple[tuple[str, tuple[int, int], _Way, tuple[float, float]], ...] = (
        ("pedestrian", _ALONG, streets.along, _WALKING),
        ("pedestrian", _ACROSS, streets.across, _WALKING),
        ("cyclist", _RIDING, streets.riding, _CYCLING),
    )
    found: dict[str, PlacedPerson] = {}
    for kind, (least, most), way, speeds in wanted:
        for _ in range(int(rng.integers(least, most + 1))):
            model = (sample_cyclist if kind == "cyclist" else sample_pedestrian)(rng)
            taken = [*others, *(person.placed for person in found.values())]
            for _ in range(_TRIES):
                points = way(rng.uniform(*speeds) * scene.ego.seconds, rng)
                person = None if points is None else streets.person(model, points, taken)
                if person is not None:
                    number = 1 + sum(name.startswith(kind) for name in found)
                    found[f"{kind}-{number}"] = person
                    break
    return found


_Way = Callable[[Array, np.random.Generator], "Array | None"]
"""Draws a way: points (T, 2) that are (T,) metres from its start, or None where it is no way."""


class _Streets:
    def __init__(self, scene: TrafficScene) -> None:
        self._scene, self._path = scene, scene.ego.path
        self._footing = Footing(scene.street.surface)
        outlines = [shapely.Polygon(part) for part in scene.street.map.drivable_area]
        self._road = shapely.union_all(outlines)
        shapely.prepare(self._road)
        first, last = scene.ego.place(scene.ego.seconds[[0, -1]])
        self._first, self._last = float(first), float(last)

    def along(self, metres: Array, rng: np.random.Generator) -> Array | None:
        """Along the pavement, with the ego's direction or against it."""
        side, way = rng.choice([-1.0, 1.0], 2)
        start, away = rng.uniform(self._first + 2, self._last + 20), rng.uniform(*_PAVEMENT)
        edge = self._edge(start, side)
        if edge is None:
            return None
        points = self._parallel(start + way * metres, side * (edge + away))
        if points is None:
            return None
        off = shapely.distance(self._road, shapely.points(points))
        return points if off.min() > 0.3 and off.max() < 4.0 else None

    def across(self, metres: Array, rng: np.random.Generator) -> Array | None:
        """From one pavement to the other, straight across the road ahead of the ego."""
        side, place = rng.choice([-1.0, 1.0]), rng.uniform(self._first + 12, self._last + 22)
        shift = rng.uniform(-0.5, 1.0)
        edges = self._edge(place, side), self._edge(place, -side)
        if edges[0] is None or edges[1] is None:
            return None
        width = edges[0] + edges[1]
        lateral = edges[0] + 0.8 - shift * max(width - metres[-1], 2.0) - metres
        if not 0 <= place <= self._path.length:
            return None
        heading = float(self._path.heading(place))
        left = np.array([-np.sin(heading), np.cos(heading)])
        points: Array = self._path.position(place) + side * lateral[:, None] * left
        return points if shapely.contains_xy(self._road, points).mean() > 0.3 else None

    def riding(self, metres: Array, rng: np.random.Generator) -> Array | None:
        """Along the road's edge, on the right."""
        way = rng.choice([-1.0, 1.0, 1.0])
        start = rng.uniform(self._first, self._last + 20)
        edge, away = self._edge(start, -way), rng.uniform(*_ROAD_EDGE)
        if edge is None or edge < away:
            return None
        points = self._parallel(start + way * metres, -way * (edge - away))
        if points is None:
            return None
        rim = shapely.distance(self._road.boundary, shapely.points(points))
        return points if shapely.contains_xy(self._road, points).all() and rim.min() > 0.4 else None

    def person(
        self, model: VehicleModel, points: Array, others: Sequence[PlacedVehicle]
    ) -> PlacedPerson | None:
        """A person on a way; None if it is blocked, touches or hides somebody, or is unseen."""
        ground = self._footing.heights(points)
        if not np.isfinite(ground).all() or self._footing.blocked(points, _BODY_ROOM):
            return None
        step = np.gradient(points, axis=0)
        poses = np.column_stack([points, np.unwrap(np.arctan2(step[:, 1], step[:, 0]))])
        if not is_seen(poses, self._scene.ego.poses, *_SEEN):
            return None
        placed = PlacedVehicle(model, poses)
        if not self._scene.fits(placed, others, _OTHERS_ROOM):
            return None
        return PlacedPerson(placed, gaussian_filter1d(ground, _KERB_STEPS, mode="nearest"))

    def _edge(self, place: float, side: float) -> float | None:
        """Metres from the ego's path to the edge of the road on one side, at a place along it."""
        if not 0 <= place <= self._path.length:
            return None
        heading = float(self._path.heading(place))
        start = self._path.position(place)
        end = start + side * _ROAD_SEARCH * np.array([-np.sin(heading), np.cos(heading)])
        inside = shapely.intersection(self._road, shapely.linestrings([start, end]))
        lines = shapely.get_parts(inside)
        lengths = [
            float(shapely.length(line))
            for line in lines
            if shapely.distance(line, shapely.points(start)) < 1e-6
        ]
        if not lengths or max(lengths) > _ROAD_SEARCH - 1:
            return None
        return max(lengths)

    def _parallel(self, places: Array, lateral: float) -> Array | None:
        """Points (T, 2) beside the ego's path at these places along it; None beyond its ends."""
        if places.min() < 0 or places.max() > self._path.length:
            return None
        heading = self._path.heading(places)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return self._path.position(places) + lateral * left


def sample_pedestrian(rng: np.random.Generator) -> VehicleModel:
    """A random pedestrian; its colour is the name of what is worn above the belt."""
    draw = rng.uniform(size=2)
    height = rng.uniform(1.1, 1.4) if draw[0] < _CHILDREN else rng.uniform(1.55, 1.92)
    name, look = _look(height, rng)
    pack = _CLOTHES[_pick(tuple(_CLOTHES), rng)]
    return moving_model("pedestrian", name, Walk(look, pack if draw[1] < _PACKS else None))


def sample_cyclist(rng: np.random.Generator) -> VehicleModel:
    """A random adult on a bicycle; its colour is the name of what is worn above the belt."""
    name, look = _look(rng.uniform(1.62, 1.86), rng)
    return moving_model("cyclist", name, Ride(look, _CLOTHES[_pick(tuple(_CLOTHES), rng)]))


def _look(height: float, rng: np.random.Generator) -> tuple[str, PersonLook]:
    name = _pick(tuple(_CLOTHES), rng)
    look = PersonLook(
        height=float(height),
        girth=float(rng.uniform(0.85, 1.25) * height / 1.75),
        skin=_SKIN[int(rng.integers(len(_SKIN)))],
        hair=_HAIR[int(rng.integers(len(_HAIR)))],
        top=_CLOTHES[name],
        trousers=_CLOTHES[_pick(_TROUSERS, rng)],
        shoes=_CLOTHES[_pick(_SHOES, rng)],
    )
    return name, look


def _pick(names: tuple[str, ...], rng: np.random.Generator) -> str:
    return names[int(rng.integers(len(names)))]
