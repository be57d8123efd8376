"""Random situations: where the ego is, who is in its way, and what happens next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recast.arrays import Array
from recast.dynamics import PACIFICA, make_state
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning import DrivingCommand
from recast.planning.pdm.forecast import box_corners
from recast_tools.planner_data.stage import ABOUT, PlacedActor, SampleStage, place_actor
from recast_tools.planner_training.targets import FORESEEN, TargetObstacle, touched

_TRIES = 60
_TRAFFIC_SHARE = 0.35
_ASIDE, _TURNED = 1.2, np.deg2rad(8.0)
_TOP_SPEED = 14.0
_CAN_BRAKE = 5.5
_ROAD_AHEAD_SECONDS, _ROAD_AHEAD_LEAST = 4.5, 25.0


@dataclass(frozen=True)
class SampleSituation:
    """One place and moment, with several speeds at which the ego may come there.

    Attributes:
        states: (K, 11) states of the ego, equal in pose.
        others: logged vehicles that are there too.
        parked: vehicles that are always there.
    """

    states: Array
    command: DrivingCommand
    actor: PlacedActor | None
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


def draw_situation(
    stage: SampleStage, with_actor: bool, speeds: int, rng: np.random.Generator
) -> SampleSituation | None:
    """A situation without overlaps and with the ego on the road; None where tries were in vain.

    Args:
        with_actor: whether a vehicle is placed by a random motion, see `place_actor`.
        speeds: number of speeds K.
    """
    parked = tuple(stage.parked())
    for _ in range(_TRIES):
        actor = place_actor(stage, rng) if with_actor else None
        if with_actor and actor is None:
            continue
        s = _place(stage, actor, rng)
        if s is None:
            continue
        pose = _perturbed(stage, s, rng)
        found = SampleSituation(
            _states(stage, pose, s, actor, speeds, rng),
            stage.route.command(pose),
            actor,
            _traffic(stage, rng),
            parked,
        )
        if _possible(stage, found):
            return _without_crashes(found)
    return None


def _place(stage: SampleStage, actor: PlacedActor | None, rng: np.random.Generator) -> float | None:
    """Route coordinate of the rear axle, or None where the road is too short."""
    route = stage.route
    if actor is None:
        s = float(rng.uniform(0.0, route.length))
    else:
        half = (PACIFICA.length + float(actor.obstacle.size[0])) / 2
        s = actor.s - actor.gap - half - PACIFICA.centre_offset
    ahead = max(_ROAD_AHEAD_SECONDS * float(route.logged_speed(s)), _ROAD_AHEAD_LEAST)
    return s if 0.0 <= s <= route.length - ahead else None


def _perturbed(stage: SampleStage, s: float, rng: np.random.Generator) -> Array:
    """The ego's pose (3,) off the route: mostly a little, in a quarter of cases a lot."""
    if rng.uniform() < 0.25:
        aside, turn = rng.uniform(-1.0, 1.0, 2) * (_ASIDE, _TURNED)
    else:
        aside, turn = np.clip(rng.normal(0.0, 0.3, 2), -1.0, 1.0) * (_ASIDE, _TURNED)
    pose = stage.route.pose(s, aside)
    pose[2] = se2.wrap_angle(pose[2] + turn)
    return pose


def _states(
    stage: SampleStage,
    pose: Array,
    s: float,
    actor: PlacedActor | None,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """(count, 11): at about the log's speed, or the one that the ego comes with; the last ones,
    less than half, at any from which the situation can mostly be mastered."""
    turn = float(se2.wrap_angle(stage.route.heading(s + 4.0) - stage.route.heading(s - 1.0)))
    bend = turn / 5.0
    fastest = min(_TOP_SPEED, np.sqrt(4.5 / max(abs(bend), 1e-3)))
    if actor is not None and actor.in_lane:
        # A little more than can be braked in time: also then braking hard is the best.
        braked = 1.5 + np.sqrt(2 * _CAN_BRAKE * max(actor.gap, 0.0))
        fastest = min(fastest, actor.slowest + braked)
    if actor is None or actor.ego_speed is None:
        usual = np.minimum(stage.route.logged_speed(s) * rng.uniform(*ABOUT, count), fastest)
    else:
        usual = actor.ego_speed * rng.uniform(0.9, 1.1, count)
    anywhere = rng.uniform(0.0, fastest, count) * (rng.uniform(size=count) > 0.06)
    speed = np.where(np.arange(count) < (count + 1) // 2, usual, anywhere)
    rate = np.where(rng.uniform(size=count) < 0.4, 0.0, rng.uniform(-3.5, 1.8, count))
    rate = np.where(speed < 0.5, np.maximum(rate, 0.0), rate)
    yaw_rate = speed * (bend + rng.normal(0.0, 0.006, count))
    return make_state(np.tile(pose, (count, 1)), speed, rate, yaw_rate)


def _traffic(stage: SampleStage, rng: np.random.Generator) -> tuple[TargetObstacle, ...]:
    if rng.uniform() > _TRAFFIC_SHARE:
        return ()
    times = stage.world.ego.timestamps_us
    latest = int(times[-1]) - 100_000 * FORESEEN
    return tuple(stage.traffic(int(rng.integers(int(times[0]), latest + 1))))


def _possible(stage: SampleStage, situation: SampleSituation) -> bool:
    """Whether the ego is on the road, and it and the actor touch nothing that stays."""
    state = situation.states[0]
    corners = box_corners(state[ego.POSE], PACIFICA)
    on_road = stage.road.map.drivable_hits(corners)
    for hits in stage.road.map.lane_hits(corners).values():
        on_road = on_road | hits
    if not on_road.all():
        return False
    placed = [] if situation.actor is None else [situation.actor.obstacle]
    if touched(state, [*situation.parked, *placed], PACIFICA):
        return False
    return not any(situation.actor.meets(o) for o in situation.parked) if situation.actor else True


def _without_crashes(situation: SampleSituation) -> SampleSituation:
    """Without logged vehicles that would stand in the ego or run into the actor."""
    state, actor = situation.states[0], situation.actor
    kept = tuple(
        other
        for other in situation.others
        if not touched(state, [other], PACIFICA) and not (actor and actor.meets(other))
    )
    return replace(situation, others=kept)
