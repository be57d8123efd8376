"""A synthetic world made ready for samples: its road, its vehicles, and the one in the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Array
from recast.dynamics import PACIFICA
from recast.geometry import se2
from recast.logs import DrivingLog
from recast.planning import ReferenceRoute
from recast.planning.map import planner_map, route_blocks
from recast.planning.pdm import Centreline
from recast.simulation import Advancing, CutIn, Oncoming, RoadSurface, StartSituation, Stationary
from recast.simulation.actor_motion import DEFAULT_LANE_OFFSET, ScriptMotion, neighbour_lateral
from recast.synthetic import world
from recast.synthetic.populate import make_world
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import Vehicle, World
from recast_tools.planner_training.targets import FORESEEN, TargetObstacle, TargetRoad

SECONDS = 16.0
_ACTORS = 4
_STREAM = 901
_SLOWEST = 3.0
"""m/s wanted where the log drove slower: it starts at a crawl in places."""
_DT = 0.1
_IN_LANE = 2.2
"""Metres beside the route within which a vehicle is in the ego's way, or about to be."""
_LATEST = 100
"""Steps of a script after which nothing new happens."""
_SHARES = {"stationary": 0.22, "oncoming": 0.25, "through": 0.05, "cut-in": 0.32, "advancing": 0.16}
"""Shares of the motions. A planner that rarely sees vehicles keep the next lane brakes for all."""
_PLAYED, _WAITING = 0.4, 0.25
"""Shares of the vehicles placed: played as a run plays them; with the ego waiting close to them."""
_EARLY = 45
"""Steps from the start of those that are played."""
_CLOSEST, _FARTHEST, _BESIDE = 0.8, 53.0, 7.0
"""Metres of gap."""
_NEAR = 12.0
"""Metres of gap at which the ego waits at most."""
ABOUT = (0.8, 1.15)
"""Shares of the log's speed, at which the ego starts."""


@dataclass(frozen=True)
class SampleStage:
    """A world to draw situations from.

    Attributes:
        world: world with vehicles that stand nowhere until they are placed.
        actors: ids of the vehicles to be placed.
    """

    world: World
    log: DrivingLog
    route: ReferenceRoute
    surface: RoadSurface
    road: TargetRoad
    actors: tuple[str, ...]

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
        times = timestamp_us + 100_000 * np.arange(FORESEEN + 1)
        return [
            TargetObstacle(key, se2.from_se3(v.trajectory.at(times)), v.model.size)
            for key, v in self.world.vehicles.items()
            if not v.parked and key not in self.actors
        ]


def make_stage(scene: str, seed: int, seconds: float = SECONDS) -> SampleStage:
    """The stage of a scene's name and a seed, with vehicles of its own; always the same.

    Raises:
        InputError: no such scene.
    """
    world = make_world(scene, seed, seconds)
    rng = np.random.default_rng([seed, _STREAM])
    actors = {f"actor-{i}": sample_vehicle(rng) for i in range(_ACTORS)}
    anywhere = world.vehicles[world.target].trajectory
    added = {key: Vehicle(key, model, anywhere, False) for key, model in actors.items()}
    return stage_of(replace(world, vehicles={**world.vehicles, **added}), tuple(actors))


def stage_of(world: World, actors: tuple[str, ...]) -> SampleStage:
    """The stage of a world, of whose vehicles some are placed."""
    log = DrivingLog(world.name, {}, {}, world.ego, {}, map=world.street.map)
    route = ReferenceRoute.from_trajectory(world.ego)
    lanes = planner_map(world.street.map)
    places = np.linspace(0.0, route.length, int(2 * route.length) + 1)
    road = TargetRoad(
        map=lanes,
        lanes=lanes.lanes_of(route_blocks(lanes, route)),
        middle=Centreline(route.pose(places)),
        speeds=np.maximum(route.logged_speed(places), _SLOWEST),
    )
    surface = RoadSurface.from_log(world.ego, route, world.street.map.ground)
    return SampleStage(world, log, route, surface, road, actors)


@dataclass(frozen=True)
class PlacedActor:
    """A vehicle from now on.

    Attributes:
        speed: speed now, m/s.
        world_from_actor: (4, 4) pose now.
        s: place along the route now, metres.
        gap: metres between the ego's front and it; negative beside the ego.
        in_lane: whether it is in the ego's way, now or within the time that is foreseen.
        slowest: least speed along the route within that time, m/s; 0 where it comes towards the
            ego.
        ego_speed: speed at which the ego comes there or waits, m/s; None if it may be any.
    """

    obstacle: TargetObstacle
    speed: float
    world_from_actor: Array
    s: float
    gap: float
    in_lane: bool
    slowest: float
    ego_speed: float | None

    def meets(self, other: TargetObstacle) -> bool:
        """Whether it touches another one, now or later."""
        mine = self.obstacle
        return bool(world.touching(mine.poses, mine.size, other.poses, other.size, 0.3).any())


def place_actor(stage: SampleStage, rng: np.random.Generator) -> PlacedActor | None:
    """A random vehicle at a random moment of a random motion around the built-in settings.

    Some are played as a run plays them, from a start at about the log's speed, the ego braking
    meanwhile more or less: then gap and speeds fit the moment. For others the ego waits: it stands
    or crawls close to the vehicle, as in most plans of a run in which it had to stop. Of the rest
    they are drawn by themselves, from what a planner gets into by its own mistakes.

    None where it would leave the recorded road within the time that is foreseen, or the ego would
    have run into it.
    """
    key = stage.actors[int(rng.integers(len(stage.actors)))]
    size = stage.world.vehicles[key].model.size
    motion, kind = _random_motion(rng), float(rng.uniform())
    played = kind < _PLAYED
    route = stage.route
    start_s = float(rng.uniform(0.0, route.length))
    beside = neighbour_lateral(stage.log, stage.log.map, route, start_s)
    if beside is None and rng.uniform() < 0.25:
        beside = -DEFAULT_LANE_OFFSET  # some logs tell so
    if played:
        started = float(np.clip(route.logged_speed(start_s) * rng.uniform(*ABOUT), 3.0, 14.0))
        begin = int(rng.integers(_EARLY))
    else:
        started, begin = float(rng.uniform(3.0, 13.0)), int(rng.integers(_LATEST))
    start = StartSituation(
        route=route,
        ego_s=start_s,
        ego_speed=started,
        ego_length=PACIFICA.length,
        actor_size=size,
        neighbour_lateral=beside,
    )
    script = motion.script(start, begin + FORESEEN, _DT)[begin:]
    s, lateral = route.project(script)
    if s.min() < 0.0 or s.max() > route.length:
        return None
    in_lane = bool(np.abs(lateral).min() < _IN_LANE)
    ahead = abs(float(lateral[0])) < _IN_LANE
    ego_speed = None
    if played:
        ego_speed = started * float(rng.uniform(0.15, 1.05))
        driven = begin * _DT * (started + ego_speed) / 2
        gap = float(s[0]) - start_s - driven - (PACIFICA.length + float(size[0])) / 2
        if gap < (_CLOSEST if ahead else -_BESIDE) or gap > _FARTHEST:
            return None
    elif ahead and kind < _PLAYED + _WAITING:
        gap = float(rng.uniform(_CLOSEST, _NEAR))
        ego_speed = max(float(rng.uniform(-0.7, 1.5)), 0.0)
    elif ahead:
        gap = _CLOSEST + (_FARTHEST - _CLOSEST) * float(rng.uniform()) ** 1.4
    else:  # beside the ego only where it stays there: from there a cut-in leaves no way out
        gap = float(rng.uniform(1.5 if in_lane else -_BESIDE, 32.0))
    poses = script[:, :3]
    return PlacedActor(
        TargetObstacle(key, poses, size),
        float(script[0, 3]),
        stage.surface.actor_poses(poses, size)[0],
        float(s[0]),
        gap,
        in_lane,
        max(float(np.diff(s).min()) / _DT, 0.0),
        ego_speed,
    )


def _random_motion(rng: np.random.Generator) -> ScriptMotion:
    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    kind = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    if kind == "stationary":
        yaw = between(-0.3, 0.3) + (np.pi if rng.uniform() < 0.35 else 0.0)
        return Stationary(
            "random",
            min_gap=between(5, 40),
            braking=3.0,
            reserve=5.0,
            yaw=yaw,
            lateral=between(-0.8, 0.8),
        )
    if kind in ("oncoming", "through"):
        stop = between(5, 30) if kind == "oncoming" else None
        return Oncoming(
            "random",
            gap=between(20, 60),
            speed=between(2, 8),
            stop_distance=stop,
            lateral=between(-0.5, 0.6),
        )
    if kind == "cut-in":
        return CutIn(
            "random",
            gap=between(3, 16),
            initial_speed=between(0.5, 1.0),
            target_speed=between(0.25, 0.7),
            delay=between(0.2, 1.5),
            duration=between(2.0, 3.8),
        )
    return Advancing("random", gap=between(3, 16), speed=between(0.35, 0.9))
