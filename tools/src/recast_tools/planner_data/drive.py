"""Drives through a synthetic world, whose moments become samples.

A planner learns from the states that it comes to (DAgger, Ross et al. 2011): from where a run
starts, an expert or a planner drives, now and then wrongly, and each half second is a sample. So
gap and speeds belong together: a car that is close ahead mostly drives as fast as the ego.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Array
from recast.dynamics import PACIFICA, make_state, plan_to_poses, track
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning import DrivingCommand
from recast.planning.gtrs.expert import FORESEEN, TargetObstacle, touched
from recast.planning.pdm.forecast import box_corners
from recast.simulation import (
    Advancing,
    Along,
    CutIn,
    Oncoming,
    RouteCrossing,
    StartSituation,
    Stationary,
)
from recast.simulation.actor_motion import DEFAULT_LANE_OFFSET, ScriptMotion, neighbour_lateral
from recast.synthetic import world
from recast_tools.planner_data.stage import SampleStage
from recast_tools.planner_training.samples import EVERY, DriveKind

MOMENTS = 12
"""Samples of a drive at most, half a second apart: as often as a planner plans."""
_BRIEF, _BRIEF_MOMENTS = 0.5, 4
"""Share of the drives with an actor that end early, and after how many moments: those in which it
is decided whether a cut-in ends well. Their share of the samples was too small to learn from."""
_DT = 0.1
_STEPS = round(EVERY / _DT)
_TRIES = 60
_SHARES: dict[DriveKind, float] = {
    "ordinary": 0.30,
    "leading": 0.15,
    "stationary": 0.11,
    "oncoming": 0.13,
    "through": 0.03,
    "cut-in": 0.16,
    "advancing": 0.12,
    "crossing": 0.12,
    "along": 0.06,
}
"""Shares of what happens. A planner that rarely follows a car brakes for every one, and one that
sees no car beside it but those that cut in brakes for these."""
_CALM = {"leading": 0.75, "cut-in": 0.5}
"""Shares of the cars ahead that drive on about as fast as they did. Where half of them brake, the
best that a planner can do behind any car is to brake."""
_TIGHT, _REACTS = 0.6, 0.5
"""Share of the oncoming cars that leave the ego just what it needs to stop with 2.5 to 6 m/s^2, and
the seconds until it brakes: where one mostly stops far off, calm braking is the best bet."""
_RIDES = {"crossing": 0.25, "along": 0.6}
"""Shares of those who ride a bicycle among the people who cross, and who go along the road."""
_MEETS = 0.7
"""Share of the people crossing who come to the route about when the ego does, if it drives on."""
_AWAY = 0.75
"""Share of the standing cars that show their rear. Nearly all others that do so drive: a planner
that meets few of these takes every rear for one that drives on."""
_TRAFFIC_WITH, _TRAFFIC_BESIDE = 0.75, 0.5
"""Shares of drives with the log's traffic: of ordinary ones, and of those with an actor."""
_ABOUT = (0.75, 1.15)
"""Shares of the log's speed at which the ego starts."""
_ASIDE, _TURNED, _FAR_OFF = 1.2, np.deg2rad(8.0), 0.2
"""Metres and radians that the ego starts off the route at most, and the share that do by a lot."""
_OTHER_SPEEDS = (0.85, 1.15)
"""Shares of the ego's speed for the further speeds of a sample."""
_LOST = 1.8
"""Metres beside the route, beyond which standing still may be best: no example of driving."""
_ROAD_AHEAD_SECONDS, _ROAD_AHEAD_LEAST = 4.5, 25.0
_STANDING, _STANDING_MOMENTS = 0.3, 4
"""m/s, and moments that a drive goes on below it: the next ones would show the same."""


@dataclass(frozen=True)
class SampleActor:
    """A vehicle that was placed, from now on: its future, and its pose (4, 4) in the world."""

    obstacle: TargetObstacle
    world_from_actor: Array


@dataclass(frozen=True)
class SampleSituation:
    """One place and moment, with several speeds at which the ego may come there.

    Attributes:
        states: (K, 11) states of the ego, equal in pose; the first is the one that it drives on.
        others: logged vehicles that are there too.
        parked: vehicles that are always there.
    """

    states: Array
    command: DrivingCommand
    actor: SampleActor | None
    others: tuple[TargetObstacle, ...]
    parked: tuple[TargetObstacle, ...]

    @property
    def obstacles(self) -> list[TargetObstacle]:
        """All that can be hit."""
        placed = [] if self.actor is None else [self.actor.obstacle]
        return [*placed, *self.others, *self.parked]

    def without_actor(self) -> SampleSituation:
        """The same, but for the vehicle placed."""
        return replace(self, actor=None)


class SampleDrive:
    """A drive in a stage, half a second at a time.

    Args:
        kind: what happens, a key of the shares.
        token: id of the actor; "" without one.
        script: (T, 4) states of the actor from the start on; none without one.
        begin_us: log time of the start, for the traffic; None without traffic.
        state: (11,) state of the ego at the start.
        moments: after how many it ends, if nothing else ends it.
    """

    def __init__(
        self,
        stage: SampleStage,
        kind: str,
        token: str,
        script: Array,
        begin_us: int | None,
        state: Array,
        moments: int = MOMENTS,
    ) -> None:
        self.stage, self.kind, self.state, self.moments = stage, kind, state, moments
        self._token, self._script, self._begin_us = token, script, begin_us
        self._parked = tuple(stage.parked())
        self._moment, self._stood = 0, 0

    def situation(self, speeds: int, rng: np.random.Generator) -> SampleSituation | None:
        """What is there now; None where the drive has ended.

        It ends after its `moments`, where the recorded road, log or script ends, where the ego
        touches something or leaves lane or road, and where it stands.
        """
        stage, state = self.stage, self.state
        s, lateral = (float(value) for value in stage.route.project(state))
        ahead = max(_ROAD_AHEAD_SECONDS * float(stage.route.logged_speed(s)), _ROAD_AHEAD_LEAST)
        stood = self._stood > _STANDING_MOMENTS
        if stood or self._moment >= self.moments or abs(lateral) > _LOST:
            return None
        if not 0.0 <= s <= stage.route.length - ahead:
            return None
        actor, others = self._actor(), self._others()
        if others is None or (self._token and actor is None) or not on_road(stage, state):
            return None
        found = SampleSituation(
            np.stack([state, *_at_other_speeds(state, speeds - 1, rng)]),
            stage.route.command(state[ego.POSE]),
            actor,
            others,
            self._parked,
        )
        return None if touched(state, found.obstacles, PACIFICA) else found

    def go(self, trajectory: Array) -> None:
        """Follow a trajectory (40, 3) to the next moment."""
        poses = plan_to_poses(self.state[ego.POSE], np.asarray(trajectory, np.float64))
        self.state = track(self.state, poses, _STEPS)[-1]
        self._stood += bool(self.state[ego.VX] < _STANDING)
        self._moment += 1

    def _actor(self) -> SampleActor | None:
        now = _STEPS * self._moment
        part = self._script[now : now + FORESEEN + 1, :3]
        if len(part) <= FORESEEN:
            return None
        size = self.stage.world.vehicles[self._token].model.size
        pose = self.stage.surface.actor_poses(part[:1], size)[0]
        return SampleActor(TargetObstacle(self._token, part, size), pose)

    def _others(self) -> tuple[TargetObstacle, ...] | None:
        """The log's traffic; None where its log has ended."""
        if self._begin_us is None:
            return ()
        time = self._begin_us + 100_000 * _STEPS * self._moment
        if time + 100_000 * FORESEEN > int(self.stage.world.ego.timestamps_us[-1]):
            return None
        return tuple(self.stage.traffic(time))


def begin_drive(
    stage: SampleStage, kinds: Sequence[DriveKind], rng: np.random.Generator
) -> SampleDrive | None:
    """A drive of one of some kinds from a random place; None where tries were in vain."""
    shares = np.array([_SHARES[kind] for kind in kinds])
    kind: DriveKind = kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]
    if kind in _RIDES and not stage.people:
        return None
    for _ in range(_TRIES):
        found = _begin(stage, kind, rng)
        if found is not None and found.situation(1, rng) is not None:
            return found
    return None


def on_road(stage: SampleStage, state: Array) -> bool:
    """Whether a state's (11,) corners are all on a lane or other drivable ground."""
    corners = box_corners(state[ego.POSE], PACIFICA)
    inside = stage.road.map.drivable_hits(corners)
    for hits in stage.road.map.lane_hits(corners).values():
        inside = inside | hits
    return bool(inside.all())


def _begin(stage: SampleStage, kind: str, rng: np.random.Generator) -> SampleDrive | None:
    route, times = stage.route, stage.world.ego.timestamps_us
    share = _TRAFFIC_WITH if kind == "ordinary" else _TRAFFIC_BESIDE
    begin_us: int | None = None
    if rng.uniform() < share:
        begin_us = int(rng.integers(int(times[0]), int(times[-1]) - 100_000 * FORESEEN))
        s = float(np.clip(route.project(stage.world.ego.at(begin_us)[:2, 3])[0], 0.0, route.length))
    else:
        s = float(rng.uniform(0.0, route.length))
    speed = float(route.logged_speed(s)) * float(rng.uniform(*_ABOUT))
    token, script = "", np.zeros((0, 4))
    if kind != "ordinary":
        speed = max(speed, 3.0)
        token = _placed(stage, kind, rng)
        script = _script(stage, kind, token, s, speed, rng)
        along = route.project(script)[0]
        if along.min() < 0.0 or along.max() > route.length:
            return None
        size = stage.world.vehicles[token].model.size
        hindered = [
            other
            for other in stage.parked()
            if world.touching(script[:, :3], size, other.poses[:1], other.size, 0.3).any()
        ]
        if hindered or (begin_us is not None and _runs_into(stage, script, size, begin_us)):
            return None
    state = _state(stage, s, speed, rng)
    brief = bool(token) and rng.uniform() < _BRIEF
    return SampleDrive(
        stage, kind, token, script, begin_us, state, _BRIEF_MOMENTS if brief else MOMENTS
    )


def _placed(stage: SampleStage, kind: str, rng: np.random.Generator) -> str:
    """Id of who takes part: a vehicle, or somebody on foot or on a bicycle."""
    among = stage.actors
    if kind in _RIDES:
        wanted = "cyclist" if rng.uniform() < _RIDES[kind] else "pedestrian"
        models = {key: stage.world.vehicles[key].model for key in stage.people}
        among = tuple(key for key, model in models.items() if model.category == wanted)
    return among[int(rng.integers(len(among)))]


def _runs_into(stage: SampleStage, script: Array, size: Array, begin_us: int) -> bool:
    """Whether an actor's script (T, 4) meets the log's traffic, which does not give way to it."""
    last = int(stage.world.ego.timestamps_us[-1])
    times = begin_us + 100_000 * np.arange(len(script))
    within = times <= last
    for other in stage.logged(times[within]):
        mine = script[within, :3]
        if world.touching(mine, size, other.poses, other.size, 0.3).any():
            return True
    return False


def _state(stage: SampleStage, s: float, speed: float, rng: np.random.Generator) -> Array:
    """The ego (11,) at the start: mostly a little off the route, now and then a lot."""
    if rng.uniform() < _FAR_OFF:
        aside, turn = rng.uniform(-1.0, 1.0, 2) * (_ASIDE, _TURNED)
    else:
        aside, turn = np.clip(rng.normal(0.0, 0.25, 2), -1.0, 1.0) * (_ASIDE, _TURNED)
    pose = stage.route.pose(s, aside)
    pose[2] = se2.wrap_angle(pose[2] + turn)
    bend = se2.wrap_angle(stage.route.heading(s + 4.0) - stage.route.heading(s - 1.0)) / 5.0
    rate = 0.0 if speed < 0.5 or rng.uniform() < 0.6 else float(rng.uniform(-1.5, 1.0))
    return make_state(pose, speed, rate, speed * float(bend))


def _at_other_speeds(state: Array, count: int, rng: np.random.Generator) -> list[Array]:
    """States (11,) at the same pose with speeds near that of a state, and its bend."""
    speed, rate = float(state[ego.VX]), float(state[ego.AX])
    bend = float(state[ego.ANGULAR_VELOCITY]) / max(speed, 0.5)
    others = np.maximum(speed * rng.uniform(*_OTHER_SPEEDS, count), 0.0)
    return [make_state(state[ego.POSE], other, rate, other * bend) for other in others]


def _script(
    stage: SampleStage, kind: str, token: str, s: float, speed: float, rng: np.random.Generator
) -> Array:
    """States (T, 4) of the actor for the whole drive."""
    beside = neighbour_lateral(stage.log, stage.log.map, stage.route, s)
    if beside is None and rng.uniform() < 0.25:
        beside = -DEFAULT_LANE_OFFSET  # some logs tell so
    start = StartSituation(
        route=stage.route,
        ego_s=s + PACIFICA.centre_offset,
        ego_speed=speed,
        ego_length=PACIFICA.length,
        actor_size=stage.world.vehicles[token].model.size,
        neighbour_lateral=0.0 if kind == "leading" else beside,
    )
    if kind in _RIDES:
        rides = stage.world.vehicles[token].model.category == "cyclist"
        motion = _on_foot_or_bicycle(kind, rides, speed, rng)
    else:
        motion = _motion(kind, speed, rng)
    return motion.script(start, _STEPS * MOMENTS + FORESEEN, _DT)


def _on_foot_or_bicycle(
    kind: str, rides: bool, speed: float, rng: np.random.Generator
) -> ScriptMotion:
    """A motion of somebody on foot or on a bicycle, for an ego's speed, m/s."""

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    own = between(2.5, 6.0) if rides else between(0.8, 2.2)
    side = 1.0 if rng.uniform() < 0.5 else -1.0
    gap = between(6, 45)
    if kind == "along":
        over = rng.uniform() < 0.3
        lateral = between(-2.5, -0.5) if rng.uniform() < 0.8 else between(0.0, 1.5)
        return Along(
            "random",
            gap=gap,
            speed=own,
            lateral=lateral,
            to=between(-0.5, 0.8) if over else None,
            delay=between(0.0, 2.5),
            duration=between(1.5, 3.0),
        )
    delay, begin = between(0.0, 1.5), between(2.5, 8.0)
    if rng.uniform() < _MEETS:
        begin = float(np.clip(own * (gap / speed + between(-1.2, 1.0) - delay), 2.0, 10.0))
    stops, turns = rng.uniform() < 0.2, rng.uniform() < 0.1
    return RouteCrossing(
        "random",
        gap=gap,
        speed=own,
        begin=side * begin,
        delay=delay,
        pause_at=side * between(-0.5, 1.8) if stops else None,
        pause=between(0.5, 4.0) if stops and rng.uniform() < 0.7 else None,
        turn_at=side * between(-1.8, -0.6) if turns else None,
    )


def _motion(kind: str, speed: float, rng: np.random.Generator) -> ScriptMotion:
    """A motion with settings around those of the built-in scenarios, for an ego's speed, m/s."""

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    calm = kind in _CALM and rng.uniform() < _CALM[kind]
    if kind == "stationary":
        yaw = between(-0.3, 0.3) + (np.pi if rng.uniform() < _AWAY else 0.0)
        return Stationary(
            "random",
            min_gap=between(12, 60),
            braking=between(3.0, 6.0),
            reserve=between(2.0, 6.0),
            yaw=yaw,
            lateral=between(-0.8, 0.8),
        )
    if kind in ("oncoming", "through"):
        gap = between(25, 70)
        stop = between(5, 30) if kind == "oncoming" else None
        if kind == "oncoming" and rng.uniform() < _TIGHT:
            needed = _REACTS * speed + speed**2 / (2.0 * between(2.5, 6.0)) + 1.0
            stop = max(gap - needed, 5.0)
        return Oncoming(
            "random",
            gap=gap,
            speed=between(2, 8),
            stop_distance=stop,
            lateral=between(-0.5, 0.6),
        )
    if kind == "cut-in":
        return CutIn(
            "random",
            gap=between(3, 18),
            initial_speed=between(0.5, 1.1),
            target_speed=between(0.8, 1.0) if calm else between(0.25, 0.8),
            delay=between(0.2, 2.5),
            duration=between(2.0, 3.8),
        )
    if kind == "leading":  # cuts in from the ego's own lane
        return CutIn(
            "random",
            gap=between(6, 40),
            initial_speed=between(0.9, 1.1) if calm else between(0.75, 1.1),
            target_speed=between(0.92, 1.1) if calm else between(0.3, 0.92),
            delay=between(0.0, 4.0),
            duration=between(2.0, 4.0),
        )
    return Advancing("random", gap=between(0, 25), speed=between(0.5, 1.4))
