"""A whole drive from a scene's name, a seed and a duration."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs import DrivingLog, Trajectory
from recast.synthetic import rig
from recast.synthetic.people import place_people
from recast.synthetic.streets import SCENES, make_street
from recast.synthetic.traffic import (
    MANNERS,
    TARGET_KINDS,
    PlacedVehicle,
    TrafficScene,
    ego_drive,
    near_spots,
    target_drive,
    try_driving,
    try_parking,
)
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import Quality, Street, Vehicle, World

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
) -> World:
    """The drive that `name`, `seed`, `seconds` and `people` stand for; always the same.

    Poses are at 10 Hz from 0 to `seconds`, rounded down to whole tenths. `light` is how cameras
    are lit; all else is the same with either. With `people` there are pedestrians and cyclists as
    well; street and traffic are the same without them.

    Raises:
        InputError: see `check_drive`.
    """
    check_drive(name, seed, seconds)
    street = make_street(
        name, _generator(name, seed, _STREET), max(_USUAL_SPEED * seconds, _SHORTEST_STREET)
    )
    return replace(populate(street, name, seed, seconds, people), light=light)


def check_drive(name: str, seed: int, seconds: float) -> None:
    """Refuse what `make_world` would refuse, before it takes its time.

    Raises:
        InputError: no such scene, a negative seed, or seconds not within 0.1 to 20.
    """
    if name not in SCENES:
        raise InputError("scene", name, "is not known", f"choose one of {', '.join(SCENES)}")
    if seed < 0:
        raise InputError("scene", "seed", f"{seed} is negative", "choose 0 or more")
    if not 1 / rig.RATE_HZ <= seconds <= _MAX_SECONDS:
        problem = f"{seconds:g} is not within {1 / rig.RATE_HZ:g} to {_MAX_SECONDS:g}"
        raise InputError("scene", "seconds", problem, "choose a duration between them")


def populate(street: Street, name: str, seed: int, seconds: float, people: bool = False) -> World:
    """A street with the ego's drive, the target and other vehicles, see `make_world`."""
    count = int(np.floor(seconds * rig.RATE_HZ + 1e-6))
    times = np.arange(count + 1) / rig.RATE_HZ
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
    """What a log says of the world it shows; `world_of` reads it back.

    A world without people does not mention them, so that its log is that of earlier releases.
    """
    metadata = {
        "dataset": DATASET,
        "licence": "Apache-2.0",
        "scene": world.name,
        "seed": str(world.seed),
        "seconds": repr(float(world.seconds)),
        "world_version": str(WORLD_VERSION),
        "target": world.target,
        "light": world.light,
    }
    return {**metadata, "people": "yes"} if world.people else metadata


def is_synthetic(log: DrivingLog) -> bool:
    """Whether a log was made from a world that can be looked at from anywhere."""
    return log.metadata.get("dataset") == DATASET


def world_of(log: DrivingLog) -> World:
    """The world that a synthetic log shows, made again.

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
    except (KeyError, ValueError, StopIteration) as error:
        raise InputError(
            log.name, "metadata", f"does not name a world ({error})", "make the log again"
        ) from None
    return make_world(name, seed, seconds, light, people)


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
