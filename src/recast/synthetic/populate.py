"""A whole drive from a scene's name, a seed and a duration; and the people who walk and ride in it.

They heed nobody and nobody heeds them, so that the traffic is the same with and without them: a way
on which anybody would be touched is not taken.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se2, se3
from recast.logs import DrivingLog, Trajectory
from recast.synthetic.gaits import PersonLook, Ride, Walk, moving_model
from recast.synthetic.streets import SCENES, make_street
from recast.synthetic.surface import Surface
from recast.synthetic.traffic import (
    MANNERS,
    TARGET_KINDS,
    PlacedVehicle,
    TrafficScene,
    ego_drive,
    is_seen,
    near_spots,
    target_drive,
    try_driving,
    try_parking,
)
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import (
    RATE_HZ,
    Conditions,
    Quality,
    Street,
    Vehicle,
    VehicleModel,
    World,
    in_conditions,
)

_SLICES = (0.35, 0.9, 1.5)
"""Heights at which the street is cut: what is met there is in a person's way."""
_STEP = 0.4
"""Metres above the road below which something is ground."""
_ALONG, _ACROSS, _RIDING = (3, 4), (1, 2), (1, 2)
"""How many, at least and at most."""
_PERSON_TRIES = 150
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
            for _ in range(_PERSON_TRIES):
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


WORLD_VERSION = 2
"""Counted up whenever the same name, seed and duration give another world or another log."""

DATASET = "synthetic"
TARGET = "target"
START_US = 1_600_000_000_000_000
_MAX_SECONDS = 20.0
_USUAL_SPEED = 10.5
"""m/s; decides where along a street its junctions and bends lie. Streets go on far enough for a
faster ego."""
_SHORTEST_STREET = 20.0
_PARKED_MOST, _PARKED_SHARE = 16, 0.75
_DRIVING_LEAST, _DRIVING_MOST = 2, 5
_TRIES = 60
_STREET, _EGO, _TARGET, _DRIVING, _PARKED, _PEOPLE = range(6)
_PARKED_KINDS = ("hatchback", "sedan", "estate", "suv", "pickup", "van")


def make_world(
    name: str,
    seed: int = 0,
    seconds: float = 8.0,
    light: Quality = "standard",
    people: bool = False,
    conditions: Conditions = "fair",
) -> World:
    """The drive that `name`, `seed`, `seconds` and `people` stand for; always the same.

    Poses are at 10 Hz from 0 to `seconds`, rounded down to whole tenths. `light` is how cameras
    are lit; all else is the same with either. With `people` there are pedestrians and cyclists as
    well; street and traffic are the same without them. `conditions` change the light and the
    exposure alone.

    Raises:
        InputError: see `check_drive`.
    """
    check_drive(name, seed, seconds)
    street = make_street(
        name, _generator(name, seed, _STREET), max(_USUAL_SPEED * seconds, _SHORTEST_STREET)
    )
    world = populate(street, name, seed, seconds, people)
    sky = in_conditions(street.sky, conditions, float(se3.yaw(world.ego.poses[0])))
    street = replace(street, sky=sky)
    return replace(world, street=street, light=light, conditions=conditions)


def check_drive(name: str, seed: int, seconds: float) -> None:
    """Refuse what `make_world` would refuse, before it takes its time.

    Raises:
        InputError: no such scene, a negative seed, or seconds not within 0.1 to 20.
    """
    if name not in SCENES:
        raise InputError("scene", name, "is not known", f"choose one of {', '.join(SCENES)}")
    if seed < 0:
        raise InputError("scene", "seed", f"{seed} is negative", "choose 0 or more")
    if not 1 / RATE_HZ <= seconds <= _MAX_SECONDS:
        problem = f"{seconds:g} is not within {1 / RATE_HZ:g} to {_MAX_SECONDS:g}"
        raise InputError("scene", "seconds", problem, "choose a duration between them")


def populate(street: Street, name: str, seed: int, seconds: float, people: bool = False) -> World:
    """A street with the ego's drive, the target and other vehicles, see `make_world`."""
    count = int(np.floor(seconds * RATE_HZ + 1e-6))
    times = np.arange(count + 1) / RATE_HZ
    ego = ego_drive(street, times, _generator(name, seed, _EGO))
    rng = _generator(name, seed, _TARGET)
    kind = TARGET_KINDS[int(rng.integers(len(TARGET_KINDS)))]
    model = sample_vehicle(rng, kind)
    driven = target_drive(street.map, ego, MANNERS.get(street.kind, "leading"), rng)
    target = PlacedVehicle(model, driven.poses(float(model.size[0])))
    scene = TrafficScene(street, ego, target)
    moving = _driving(scene, name, seed)
    parked = _parked(scene, moving, name, seed)

    vehicles = {TARGET: _vehicle(TARGET, target, False, times)}
    for i, placed in enumerate(moving, 1):
        vehicles[f"moving-{i}"] = _vehicle(f"moving-{i}", placed, False, times)
    for i, placed in enumerate(parked, 1):
        vehicles[f"parked-{i:02d}"] = _vehicle(f"parked-{i:02d}", placed, True, times)
    if people:
        rng = _generator(name, seed, _PEOPLE)
        for key, person in place_people(scene, [*moving, *parked], rng).items():
            vehicles[key] = _vehicle(key, person.placed, False, times, person.ground)
    trajectory = Trajectory(_stamps(times), se2.to_se3(ego.poses))
    return World(name, seed, seconds, street, vehicles, trajectory, TARGET, people=people)


def world_metadata(world: World) -> dict[str, str]:
    """What a log says of the world it shows; `world_of` reads it back."""
    drive = (world.name, world.seed, world.seconds, world.light, world.people, world.conditions)
    return {**drive_metadata(*drive), "target": world.target}


def drive_metadata(
    name: str,
    seed: int,
    seconds: float,
    light: Quality = "standard",
    people: bool = False,
    conditions: Conditions = "fair",
) -> dict[str, str]:
    """The metadata of the log of `make_world` with these arguments, without making it.

    People and conditions are mentioned only where they are not as in earlier releases.
    """
    metadata = {
        "dataset": DATASET,
        "licence": "Apache-2.0",
        "scene": name,
        "seed": str(seed),
        "seconds": repr(float(seconds)),
        "world_version": str(WORLD_VERSION),
        "target": TARGET,
        "light": light,
    }
    if people:
        metadata["people"] = "yes"
    if conditions != "fair":
        metadata["conditions"] = conditions
    return metadata


def is_synthetic(log: DrivingLog) -> bool:
    """Whether a log was made from a world that can be looked at from anywhere."""
    return log.metadata.get("dataset") == DATASET


def world_of(log: DrivingLog) -> World:
    """The world that a synthetic log shows, made again. Raises InputError: see `drive_of`."""
    return make_world(*drive_of(log))


def drive_of(log: DrivingLog) -> tuple[str, int, float, Quality, bool, Conditions]:
    """The arguments of `make_world` for the world that a synthetic log shows.

    Raises:
        InputError: the log is not synthetic, or another version of recast made it.
    """
    metadata: Mapping[str, str] = log.metadata
    if not is_synthetic(log):
        found = metadata.get("dataset", "not named")
        problem = f"is {found!r}: only synthetic worlds can be made again"
        raise InputError(log.name, "dataset", problem, "use a log made by recast log synth")
    if metadata.get("world_version") != str(WORLD_VERSION):
        problem = f"is {metadata.get('world_version')!r}, this recast makes {WORLD_VERSION}"
        mend = "make the log again: recast log synth"
        raise InputError(log.name, "world_version", problem, mend)
    try:
        name, seed, seconds = metadata["scene"], int(metadata["seed"]), float(metadata["seconds"])
        light = next(known for known in get_args(Quality) if known == metadata["light"])
        people = {"no": False, "yes": True}[metadata.get("people", "no")]
        told = metadata.get("conditions", "fair")
        conditions = next(known for known in get_args(Conditions) if known == told)
    except (KeyError, ValueError, StopIteration) as error:
        raise InputError(
            log.name, "metadata", f"does not name a world ({error})", "make the log again"
        ) from None
    return name, seed, seconds, light, people, conditions


def _driving(scene: TrafficScene, name: str, seed: int) -> list[PlacedVehicle]:
    rng = _generator(name, seed, _DRIVING)
    wanted = int(rng.integers(_DRIVING_LEAST, _DRIVING_MOST + 1))
    moving: list[PlacedVehicle] = []
    for number in range(wanted):
        model = sample_vehicle(_generator(name, seed, _DRIVING, number))
        for _ in range(_TRIES):
            placed = try_driving(scene, model, moving, rng)
            if placed is not None:
                moving.append(placed)
                break
    return moving


def _parked(
    scene: TrafficScene, moving: list[PlacedVehicle], name: str, seed: int
) -> list[PlacedVehicle]:
    rng = _generator(name, seed, _PARKED)
    parked: list[PlacedVehicle] = []
    for number, spot in enumerate(near_spots(scene)):
        taken, kind = rng.uniform() < _PARKED_SHARE, int(rng.integers(len(_PARKED_KINDS)))
        if not taken or len(parked) >= _PARKED_MOST:
            continue
        model = sample_vehicle(_generator(name, seed, _PARKED, number), _PARKED_KINDS[kind])
        placed = try_parking(scene, spot, model, [*moving, *parked])
        if placed is not None:
            parked.append(placed)
    return parked


def _vehicle(
    track_id: str, placed: PlacedVehicle, parked: bool, times: Array, ground: Array | float = 0.0
) -> Vehicle:
    poses = se2.to_se3(placed.poses, ground + placed.model.size[2] / 2)
    return Vehicle(track_id, placed.model, Trajectory(_stamps(times), poses), parked)


def _stamps(times: Array) -> NDArray[np.int64]:
    return START_US + np.rint(times * 1e6).astype(np.int64)


def _generator(name: str, seed: int, *stream: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *stream])
