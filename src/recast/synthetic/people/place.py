"""Where people walk and ride: on the pavement, across the road, along its edge.

They heed nobody and nobody heeds them, so that the traffic is the same with and without them: a way
on which anybody would be touched is not taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from recast.geometry import se2
from recast.synthetic.others import Placed, Scene
from recast.synthetic.people.footing import Footing
from recast.synthetic.people.sample import sample_cyclist, sample_pedestrian
from recast.synthetic.world import VehicleModel

Array = NDArray[np.float64]

_ALONG, _ACROSS, _RIDING = (3, 4), (1, 2), (1, 2)
"""How many, at least and at most."""
_TRIES = 150
_WALKING, _CYCLING = (1.0, 1.6), (3.5, 6.0)
_PAVEMENT = (0.5, 2.2)
"""Metres from the edge of the road."""
_ROAD_EDGE = (0.6, 2.4)
_ROAD_SEARCH = 30.0
_BODY_ROOM, _OTHERS_ROOM = 0.4, 0.5
_SEEN_WITHIN, _SEEN_FIELD, _SEEN_SHARE = 28.0, np.deg2rad(60), 0.2
_KERB_STEPS = 3
"""Poses over which a step up or down is spread (standard deviation)."""


@dataclass(frozen=True)
class PlacedPerson:
    """A person with its poses.

    Attributes:
        placed: planar poses.
        ground: (T,) height under it.
    """

    placed: Placed
    ground: Array


def place_people(
    scene: Scene, others: Sequence[Placed], rng: np.random.Generator
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
    def __init__(self, scene: Scene) -> None:
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
        self, model: VehicleModel, points: Array, others: Sequence[Placed]
    ) -> PlacedPerson | None:
        """A person on a way; None if it is blocked, touches or hides somebody, or is unseen."""
        ground = self._footing.heights(points)
        if not np.isfinite(ground).all() or self._footing.blocked(points, _BODY_ROOM):
            return None
        step = np.gradient(points, axis=0)
        poses = np.column_stack([points, np.unwrap(np.arctan2(step[:, 1], step[:, 0]))])
        if not _is_seen(poses, self._scene.ego.poses):
            return None
        placed = Placed(model, poses)
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


def _is_seen(poses: Array, rig: Array) -> bool:
    """Whether it is near and in front of the ego for some of the time."""
    seen = se2.relative(rig, poses)
    distance, bearing = np.hypot(seen[:, 0], seen[:, 1]), np.arctan2(seen[:, 1], seen[:, 0])
    visible = (distance < _SEEN_WITHIN) & (np.abs(bearing) < _SEEN_FIELD)
    return bool(visible.mean() >= _SEEN_SHARE)
