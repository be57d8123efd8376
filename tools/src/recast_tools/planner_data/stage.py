"""A synthetic world made ready for samples: its road, vehicles, people, and who is in the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Int64Array
from recast.geometry import se2
from recast.logs import DrivingLog
from recast.planning import ReferenceRoute
from recast.planning.gtrs.expert import FORESEEN, TargetObstacle, TargetRoad, target_road
from recast.simulation import RoadSurface
from recast.synthetic.populate import make_world, sample_cyclist, sample_pedestrian
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import Vehicle, World

SECONDS = 16.0
_ACTORS, _WALKERS, _RIDERS = 4, 4, 2
_STREAM = 901


@dataclass(frozen=True)
class SampleStage:
    """A world to draw situations from.

    Attributes:
        world: world with vehicles that stand nowhere until they are placed.
        actors: ids of the vehicles to be placed.
        people: ids of the pedestrians and cyclists to be placed; none in a reconstructed world.
    """

    world: World
    log: DrivingLog
    route: ReferenceRoute
    surface: RoadSurface
    road: TargetRoad
    actors: tuple[str, ...]
    people: tuple[str, ...] = ()

    def parked(self) -> list[TargetObstacle]:
        """The vehicles that are always there."""
        return [
            TargetObstacle(
                key, np.tile(se2.from_se3(v.trajectory.poses[0]), (FORESEEN + 1, 1)), v.model.size
            )
            for key, v in self.world.vehicles.items()
            if v.parked
        ]

    def traffic(self, timestamp_us: int) -> list[TargetObstacle]:
        """The vehicles that drive in the log, from a time on; the target is one of them."""
        return self.logged(timestamp_us + 100_000 * np.arange(FORESEEN + 1))

    def logged(self, times: Int64Array) -> list[TargetObstacle]:
        """The same at times (T,) of the log, microseconds."""
        return [
            TargetObstacle(key, se2.from_se3(v.trajectory.at(times)), v.model.size)
            for key, v in self.world.vehicles.items()
            if not v.parked and key not in (*self.actors, *self.people)
        ]


def make_stage(scene: str, seed: int, seconds: float = SECONDS) -> SampleStage:
    """The stage of a scene's name and a seed, with vehicles of its own; always the same.

    Raises:
        InputError: no such scene.
    """
    world = make_world(scene, seed, seconds, people=True)
    rng = np.random.default_rng([seed, _STREAM])
    actors = {f"actor-{i}": sample_vehicle(rng) for i in range(_ACTORS)}
    people = {f"person-{i}": sample_pedestrian(rng) for i in range(_WALKERS)}
    people |= {f"rider-{i}": sample_cyclist(rng) for i in range(_RIDERS)}
    anywhere = world.vehicles[world.target].trajectory
    added = {key: Vehicle(key, model, anywhere, False) for key, model in actors.items()}
    # Limbs move with the way: of those who are placed, with the ego's.
    added |= {key: Vehicle(key, model, world.ego, False) for key, model in people.items()}
    whole = replace(world, vehicles={**world.vehicles, **added})
    return stage_of(whole, tuple(actors), tuple(people))


def stage_of(world: World, actors: tuple[str, ...], people: tuple[str, ...] = ()) -> SampleStage:
    """The stage of a world, of whose vehicles and people some are placed."""
    log = DrivingLog(world.name, {}, {}, world.ego, {}, map=world.street.map)
    route = ReferenceRoute.from_trajectory(world.ego)
    road = target_road(route, world.street.map)
    surface = RoadSurface.from_log(world.ego, route, world.street.map.ground)
    return SampleStage(world, log, route, surface, road, actors, people)
