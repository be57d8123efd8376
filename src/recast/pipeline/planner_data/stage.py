"""A synthetic world made ready for samples: its road, and vehicles to be placed on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.logs import DrivingLog
from recast.planning import ReferenceRoute
from recast.planning.gtrs_training.collisions import FORESEEN, Obstacle
from recast.planning.gtrs_training.targets import Road
from recast.planning.map import planner_map, route_blocks
from recast.planning.pdm import LanePath
from recast.simulation import RoadSurface
from recast.synthetic.populate import make_world
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import Vehicle, World

Array = NDArray[np.float64]

SECONDS = 16.0
_ACTORS = 4
_STREAM = 901
_SLOWEST = 3.0
"""m/s wanted where the log drove slower: it starts at a crawl in places."""


@dataclass(frozen=True)
class Stage:
    """A world to draw situations from.

    Attributes:
        world: with further vehicles, which stand nowhere until they are placed.
        log: its drive, without sensors.
        route, surface, road: where the ego drives.
        actors: ids of the vehicles to be placed.
    """

    world: World
    log: DrivingLog
    route: ReferenceRoute
    surface: RoadSurface
    road: Road
    actors: tuple[str, ...]

    def parked(self) -> list[Obstacle]:
        """The vehicles that are always there."""
        return [
            Obstacle(key, np.tile(se2.from_se3(v.trajectory.poses[0]), (FORESEEN + 1, 1)),
                     v.model.size)
            for key, v in self.world.vehicles.items() if v.parked
        ]  # fmt: skip

    def traffic(self, timestamp_us: int) -> list[Obstacle]:
        """The vehicles that drive in the log, from a time on; the target is one of them."""
        times = timestamp_us + 100_000 * np.arange(FORESEEN + 1)
        return [
            Obstacle(key, se2.from_se3(v.trajectory.at(times)), v.model.size)
            for key, v in self.world.vehicles.items() if not v.parked and key not in self.actors
        ]  # fmt: skip


def make_stage(scene: str, seed: int, seconds: float = SECONDS) -> Stage:
    """The stage of a scene's name and a seed; always the same.

    Raises:
        InputError: no such scene.
    """
    world = make_world(scene, seed, seconds)
    rng = np.random.default_rng([seed, _STREAM])
    actors = {f"actor-{i}": sample_vehicle(rng) for i in range(_ACTORS)}
    anywhere = world.vehicles[world.target].trajectory
    added = {key: Vehicle(key, model, anywhere, False) for key, model in actors.items()}
    world = replace(world, vehicles={**world.vehicles, **added})
    log = DrivingLog(world.name, {}, {}, world.ego, {}, map=world.street.map)
    route = ReferenceRoute.from_trajectory(world.ego)
    lanes = planner_map(world.street.map)
    places = np.linspace(0.0, route.length, int(2 * route.length) + 1)
    road = Road(
        map=lanes,
        lanes=lanes.lanes_of(route_blocks(lanes, route)),
        middle=LanePath(route.pose(places)),
        speeds=np.maximum(route.logged_speed(places), _SLOWEST),
    )
    surface = RoadSurface.from_log(world.ego, route, world.street.map.ground)
    return Stage(world, log, route, surface, road, tuple(actors))
