"""What a rollout is asked to be: settings, log, motions, controller and renderer."""

from __future__ import annotations

import math
import os
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from recast.arrays import Array
from recast.core.arguments import check_fields
from recast.core.errors import InputError
from recast.core.foreign import BasePart, lacks, whole
from recast.core.plugins import SCENES
from recast.dynamics import (
    PACIFICA,
    PRESETS,
    TrackerConfig,
    VehicleParameters,
    follow_perfectly,
    plan_to_poses,
    track,
)
from recast.dynamics import state as ego
from recast.logs.hdmap import HdMap
from recast.logs.types import DrivingLog, Track
from recast.planning import WAYPOINTS, PlanningContext
from recast.simulation.actor_motion import AnyMotion, BaseMotion, whole_motion
from recast.simulation.renderer import BaseRenderer, SensorRenderer, camera_mounts
from recast.simulation.scenario import (
    Scenario,
    further_actors,
    motion,
    replaced_tracks,
    scenario_name,
    target_motion,
)

if TYPE_CHECKING:
    from recast.scene.street_scene import StreetScene


TrafficKind = Literal["none", "replay", "idm"]


class EgoController(Protocol):
    """Executes the first waypoints of a plan; what it is given is read-only.

    This method is enough; `BaseController` has all others, with their defaults.
    """

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one (11,) first.

        Args:
            waypoints: (40, 3) waypoints in the ego frame of `state`, `dt` apart.
            steps: how many steps to execute.
            vehicle: the ego.
            dt: seconds per step, and between waypoints.
        """


class BaseController(BasePart):
    """An `EgoController` with all members that are asked for: derive yours from it."""

    def reset(self, context: PlanningContext) -> None:
        """Forget the last rollout and prepare for the next."""

    @abstractmethod
    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), see `EgoController`."""


@dataclass(frozen=True)
class LqrController(BaseController):
    """nuPlan's LQR tracker and kinematic bicycle with actuator lag.

    The paper says that the ego controller executes the first K waypoints, not which controller it
    is. We take the tracker of the benchmark that the published planners were made for.
    """

    config: TrackerConfig = PRESETS["default"]

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Fit the plan's profiles once and track them; see `recast.dynamics.track`."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return track(state, poses, steps, self.config, vehicle, dt)


@dataclass(frozen=True)
class PerfectController(BaseController):
    """Puts the ego onto the waypoints: shows what the plans alone would do."""

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Jump from waypoint to waypoint; speeds and rates are their differences."""
        poses = plan_to_poses(state[ego.POSE], waypoints)
        return follow_perfectly(state, poses, steps, vehicle, dt)


_DT = (0.05, 0.2)
"""Seconds per step, within which 40 waypoints reach 2 to 8 s: the tracker looks 1 s ahead, and no
planner plans further than 8 s."""
_MOST_STEPS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class RolloutSettings:
    """How a rollout is run, whatever is driven in it.

    Attributes:
        arm: what renders it, for tables; has no influence on the motion.
        map: lanes, drivable area and ground, or None for the log's.
        start_timestamp_us: log time of state 0; None for what the target's motion says (see
            `TimedPath`), or else the first ego pose with 3 m/s or more that leaves enough log for
            all steps, or else the first pose.
        steps: number of steps of `dt` seconds; 160 in the paper.
        plan_every: steps between plans, K; 40 at most, since a plan has 40 waypoints.
        dt: seconds per step and between waypoints, for controller, planner, actor and metrics.
        vehicle: outline and wheelbase of the ego, for controller, planner and metrics.
        controller: executes the plans; it is given `dt` and `vehicle`.
        traffic: what the log's other road users do, see `recast.simulation.traffic`: "none" takes
            them out, as the paper does; "replay" leaves them on their logged motion; "idm" lets
            them give way on their logged paths.
        road_margin: metres before the end of the logged road at which a rollout is cut.
        camera_names: cameras for `on_frame`, and for planners that do not say which they look at
            (see `planner_cameras`); None for all of the log.
        plan_limit_s: seconds of wall-clock time that one plan may take; a planner that takes longer
            fails the rollout. It runs in a process of its own then, see `PlannerProcess`. None for
            no limit, on which no result may depend.
        start_left: metres to the left of where the log has it at which the ego starts, with its
            past. Scripts do not depend on it.
        seed: seed of random numbers of motions and of the planner.
        end_on_contact: end with the plan in which the ego touches a road user, for searches:
            what comes later decides nothing; but not before two plans were executed.

    Raises:
        InputError: a value is of the wrong type or out of its range.
    """

    arm: str = "scene"
    map: HdMap | None = None
    start_timestamp_us: int | None = None
    steps: int = 160
    plan_every: int = 5
    dt: float = 0.1
    vehicle: VehicleParameters = PACIFICA
    controller: EgoController = field(default_factory=LqrController)
    traffic: TrafficKind = "none"
    road_margin: float = 2.0
    camera_names: Sequence[str] | None = None
    plan_limit_s: float | None = None
    start_left: float = 0.0
    seed: int = 0
    end_on_contact: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "controller", whole(self.controller, BaseController))
        for field_name, low, high in (("steps", 1, _MOST_STEPS), ("plan_every", 1, WAYPOINTS)):
            value = getattr(self, field_name)
            if not low <= value <= high:
                raise self._refused(field_name, f"is {value}", f"give {low} to {high}")
        microseconds = self.dt * 1e6
        fits = math.isfinite(microseconds) and abs(microseconds - round(microseconds)) < 1e-3
        if not (fits and _DT[0] <= self.dt <= _DT[1]):
            mend = f"give {_DT[0]:g} to {_DT[1]:g} s, in whole microseconds"
            raise self._refused("dt", f"is {self.dt} s", mend)
        if self.plan_limit_s is not None and not self.plan_limit_s > 0.0:
            mend = "give more than 0, or None"
            raise self._refused("plan_limit_s", f"is {self.plan_limit_s} s", mend)
        if not math.isfinite(self.start_left):
            raise self._refused("start_left", f"is {self.start_left} m", "give a number of metres")
        if not 0.0 <= self.road_margin < math.inf:
            raise self._refused("road_margin", f"is {self.road_margin} m", "give 0 or more")

    def _refused(self, field_name: str, problem: str, mend: str) -> InputError:
        return InputError(type(self).__name__, field_name, problem, mend)


@dataclass(frozen=True)
class RolloutSetup(RolloutSettings):
    """A rollout to be run: its settings, and what is driven in it.

    Attributes:
        log: the recorded drive; its map is used unless `map` is given.
        track_id: the target, the actor to control.
        motion: what it does; a `Scenario` also brings further actors.
        actors: further controlled actors beside the target, by track id, with their motions.

    Raises:
        InputError: see `RolloutSettings`; or a motion is not one, or a track has two.
    """

    log: DrivingLog
    track_id: str
    motion: AnyMotion | Scenario
    actors: Mapping[str, AnyMotion] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.motion, Scenario):
            object.__setattr__(self, "motion", _motion_of(self.track_id, self.motion))
        further = {track_id: _motion_of(track_id, one) for track_id, one in self.actors.items()}
        object.__setattr__(self, "actors", further)
        brought = [actor.track_id for actor in further_actors(self.motion)]
        ids = [self.track_id, *brought, *self.actors]
        for track_id in ids:
            if ids.count(track_id) > 1:
                problem = f"track {track_id} is given twice"
                raise self._refused("actors", problem, "give each track one motion")

    @property
    def name(self) -> str:
        """Unique among the arms and scenarios of one track."""
        return f"{scenario_name(self.motion)}-{self.arm}"

    @property
    def controlled(self) -> dict[str, BaseMotion]:
        """Motions of all controlled actors by track id, the target first."""
        brought = {actor.track_id: actor.motion for actor in further_actors(self.motion)}
        given = {**brought, **self.actors}
        further = {track_id: whole_motion(one) for track_id, one in given.items()}
        return {self.track_id: target_motion(self.motion), **further}

    @property
    def description(self) -> str:
        """What the scenario is, for people; or ""."""
        if isinstance(self.motion, Scenario):
            return self.motion.description
        return whole_motion(self.motion).description

    @property
    def replaced(self) -> tuple[str, ...]:
        """Tracks beside the target whose vehicles the scenario wants replaced."""
        return replaced_tracks(self.motion)

    @property
    def hdmap(self) -> HdMap | None:
        """The map in use."""
        return self.log.map if self.map is None else self.map

    @property
    def track(self) -> Track:
        """The controlled track.

        Raises:
            InputError: the log has no such track.
        """
        return self.track_of(self.track_id)

    def track_of(self, track_id: str) -> Track:
        """A track of the log.

        Raises:
            InputError: the log has no such track.
        """
        if track_id not in self.log.tracks:
            raise InputError(
                self.log.name,
                f"track {track_id}",
                "is not in the log",
                f"choose one of {', '.join(self.log.tracks)}",
            )
        return self.log.tracks[track_id]


def _motion_of(track_id: str, motion: AnyMotion) -> BaseMotion:
    return whole_motion(motion, f"motion of track {track_id}")


def make_setup(
    log: DrivingLog,
    settings: RolloutSettings,
    actors: Mapping[str, str | Path | AnyMotion | Scenario],
) -> RolloutSetup:
    """The setup of a rollout.

    Args:
        actors: controlled actors by track id: a motion, or its name such as "cut-in". The first
            one is the target.

    Raises:
        InputError: no actor, or no such motion.
    """
    if not isinstance(actors, Mapping) or not actors:
        mend = "name the target and its motion, such as actors={'0': 'cut-in'}"
        raise InputError("Simulator", "actors", "is empty or not a mapping", mend)
    (target, scripted), *others = ((key, motion(value)) for key, value in actors.items())
    further: dict[str, AnyMotion] = {}
    for key, value in others:
        if isinstance(value, Scenario):
            problem = f"track {key} is given the scenario {value.name}, which has several actors"
            raise InputError("Simulator", "actors", problem, "give the scenario to the first track")
        further[key] = value
    members = {one.name: getattr(settings, one.name) for one in fields(RolloutSettings)}
    return RolloutSetup(log, target, scripted, actors=further, **members)


def as_renderer(
    log: DrivingLog,
    scene: StreetScene | SensorRenderer | None,
    cameras: Sequence[str] | None,
    scale: float,
    device: str,
) -> BaseRenderer | None:
    """The renderer of a simulator; see `Simulator` for the arguments.

    Raises:
        InputError: no such camera or device, a scale that is no size, or what is no scene.
    """
    if scene is None:
        if cameras:
            raise InputError("Simulator", "cameras", "are given without a scene", "give a scene")
        return None
    if isinstance(scene, str | os.PathLike):
        scene = SCENES.resolve(scene)
    if not lacks(scene, BaseRenderer):
        return whole(scene, BaseRenderer)
    from recast.scene.street_scene import StreetScene  # needs torch
    from recast.simulation.scene_renderer import SceneRenderer

    if not isinstance(scene, StreetScene):
        problem = f"is a {type(scene).__name__}"
        mend = "give a StreetScene, a renderer with mounts and render, or None"
        raise InputError("Simulator", "scene", problem, mend)
    if not 0.0 < scale <= 4.0:
        raise InputError("Simulator", "scale", f"is {scale}", "give more than 0, at most 4")
    return SceneRenderer(scene, camera_mounts(log, cameras, scale), device)
