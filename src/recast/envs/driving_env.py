"""The simulator as a gymnasium environment: what its agent does and sees, what a step is worth."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import gymnasium
import numpy as np
import shapely
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.core.foreign import BasePart, whole
from recast.dynamics import BicycleModel, VehicleParameters
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.geometry.boxes import TOUCHING
from recast.logs import DrivingLog, load_log
from recast.logs.hdmap import drivable_region
from recast.metrics.driving import any_collision, drivable_area_compliance, no_collision
from recast.metrics.rollout_metrics import rollout_metrics
from recast.planning import (
    WAYPOINTS,
    Plan,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
)
from recast.planning.types import ACTOR_COLUMNS, COMMANDS
from recast.simulation import (
    AnyMotion,
    BaseController,
    Ending,
    Rollout,
    RolloutSettings,
    Scenario,
    SensorRenderer,
    Simulator,
)
from recast.simulation.setup import as_renderer

if TYPE_CHECKING:
    from recast.scene.street_scene import StreetScene


ActionKind = Literal["waypoints", "controls"]
KINDS = ("waypoints", "controls")

_LOW = np.array([-4.05, -0.5], np.float32)
_HIGH = np.array([2.4, 0.5], np.float32)
_MODEL = BicycleModel()
ROUTE_POINTS = 20
ROUTE_SPACING = 2.5
"""Metres between the points of the route ahead."""
_SECONDS = 2.0


def action_space(kind: ActionKind) -> spaces.Space[NDArray[np.float32]]:
    """Waypoints (40, 3) as in `Plan`, or acceleration in m/s^2 and steering rate in rad/s (2,)."""
    if kind == "waypoints":
        box = spaces.Box(-np.inf, np.inf, (WAYPOINTS, 3), np.float32)
    else:
        box = spaces.Box(_LOW, _HIGH, (2,), np.float32)
    return cast("spaces.Space[NDArray[np.float32]]", box)


def checked_action(action: object, kind: ActionKind) -> Array:
    """An action as float64, controls clipped to their range.

    Raises:
        InputError: it is no array of finite numbers of the right shape.
    """
    shape = (WAYPOINTS, 3) if kind == "waypoints" else (2,)
    mend = f"give {kind} {shape}, as in DrivingEnv.action_space"
    try:
        values = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        raise InputError("DrivingEnv", "action", "is not an array of numbers", mend) from None
    if values.shape != shape:
        raise InputError("DrivingEnv", "action", f"has the shape {values.shape}", mend)
    if not np.isfinite(values).all():
        at = np.argwhere(~np.isfinite(values))[0].tolist()
        raise InputError("DrivingEnv", "action", f"is NaN or infinite at {at}", mend)
    return values if kind == "waypoints" else np.clip(values, _LOW, _HIGH)


class HeldControls(BaseController):
    """An ego controller that holds one acceleration and steering rate, whatever the plan says.

    The kinematic bicycle has the actuator lag of the LQR controller's and never drives backwards.

    Attributes:
        command: (2,) acceleration in m/s^2 and steering rate in rad/s.
    """

    def __init__(self) -> None:
        self.command: Array = np.zeros(2)

    def reset(self, context: PlanningContext) -> None:
        """Neither accelerate nor steer."""
        self.command = np.zeros(2)

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one first."""
        states = [np.asarray(state, np.float64)]
        for _ in range(steps):
            new = _MODEL.step(states[-1], self.command, vehicle, dt)
            if new[ego.VX] < 0.0:
                new[[ego.VX, ego.AX, ego.ANGULAR_VELOCITY, ego.ANGULAR_ACCELERATION]] = 0.0
            states.append(new)
        return np.array(states)

    def plan(self, state: Array, vehicle: VehicleParameters, dt: float) -> Plan:
        """Where the command leads within the horizon of a plan: for metrics that look ahead."""
        states = self.execute(state, np.zeros((WAYPOINTS, 3)), WAYPOINTS, vehicle, dt)
        return Plan(se2.relative(states[0, ego.POSE], states[1:, ego.POSE]))


def history_length(dt: float) -> int:
    """States in `history`: 2 s and the present one."""
    return round(_SECONDS / dt) + 1


def observation_space(
    mounts: Mapping[str, CameraMount], history: int, most_actors: int
) -> spaces.Dict:
    """The space of `observation`; without cameras it has no `images`."""
    images: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(0, 255, (mount.camera.height, mount.camera.width, 3), np.uint8)
        for name, mount in mounts.items()
    }
    parts: dict[str, spaces.Space[Any]] = {
        "ego": _numbers(ego.SIZE),
        "history": _numbers(history, ego.SIZE),
        "route": _numbers(ROUTE_POINTS, 2),
        "command": spaces.Discrete(len(COMMANDS)),
        "actors": _numbers(most_actors, len(ACTOR_COLUMNS)),
        "actors_mask": spaces.MultiBinary(most_actors),
    }
    if images:
        parts["images"] = spaces.Dict(images)
    return spaces.Dict(parts)


def observation(
    seen: PlannerInput, route: ReferenceRoute, history: int, most_actors: int
) -> dict[str, Any]:
    """What a planner sees, as arrays in the present ego frame (rear axle).

    Returns:
        `ego` (11,) and `history` (history, 11) with the columns of `recast.dynamics.state`, oldest
        first, the oldest known one repeated before it; `route` (20, 2) points 2.5 m apart from the
        ego on, its end repeated beyond it; `command`, an index into `recast.planning.types.
        COMMANDS`; `actors` (A, 8), see `ACTOR_COLUMNS`, in the order of `PlannerInput.actors`, and
        `actors_mask` (A,), 1 where there is one; `images` by camera name.
    """
    pose = seen.ego.pose
    past = np.asarray(seen.ego_history, np.float64)[-history:].copy()
    past[:, ego.POSE] = se2.relative(pose, past[:, ego.POSE])
    past[-1, ego.POSE] = 0.0  # exactly
    missing = history - len(past)
    s = float(route.project(pose, seen.route_s)[0])
    ahead = np.clip(s + ROUTE_SPACING * np.arange(ROUTE_POINTS), 0.0, route.length)
    actors = np.zeros((most_actors, len(ACTOR_COLUMNS)))
    shown = seen.actors[:most_actors]
    for row, actor in enumerate(shown):
        actors[row] = actor.seen_from(pose)
    mask = np.zeros(most_actors, np.int8)
    mask[: len(shown)] = 1
    made: dict[str, Any] = {
        "ego": past[-1].astype(np.float32),
        "history": np.concatenate([np.repeat(past[:1], missing, axis=0), past]).astype(np.float32),
        "route": se2.relative(pose, route.pose(ahead))[:, :2].astype(np.float32),
        "command": np.int64(COMMANDS.index(seen.command)),
        "actors": actors.astype(np.float32),
        "actors_mask": mask,
    }
    if seen.images:
        made["images"] = {name: image.copy() for name, image in seen.images.items()}
    return made


def _numbers(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


@dataclass(frozen=True)
class StepFacts:
    """What happened between two observations.

    Attributes:
        steps: simulation steps that were executed.
        seconds: duration of these steps.
        progress: metres that the ego advanced along the route.
        lateral: metres from the route to the ego's rear axle now, left positive.
        speed: speed of the ego now, m/s.
        collision: whether the ego overlapped a controlled actor.
        overlap: largest overlap, square metres.
        off_road: whether a corner of the ego left the drivable area by more than 0.3 m; False
            without a map.
        off_road_distance: how far the ego left the drivable area, metres; 0 without a map.
        route_end: whether the ego came to the end of the route.
    """

    steps: int
    seconds: float
    progress: float
    lateral: float
    speed: float
    collision: bool
    overlap: float
    off_road: bool
    off_road_distance: float
    route_end: bool

    def to_info(self) -> dict[str, Any]:
        """Plain values by name."""
        return asdict(self)


class Reward(Protocol):
    """A number for what happened: a function, or an object that is called.

    That is enough; `BaseReward` has all members, with their defaults.
    """

    def __call__(self, facts: StepFacts) -> float:
        """The reward of one step."""


class BaseReward(BasePart):
    """A `Reward` with all members that are asked for: derive yours from it."""

    @abstractmethod
    def __call__(self, facts: StepFacts) -> float:
        """The reward of one step."""

    def parts(self, facts: StepFacts) -> Mapping[str, float]:
        """The terms of the reward by name, for `info`."""
        return {}


@dataclass(frozen=True)
class ProgressReward(BaseReward):
    """Progress along the route, less a penalty in each step with a collision or off the road.

    Attributes:
        progress: reward for each metre along the route.
        collision, off_road: penalty for a step with a collision, and for one off the road.
    """

    progress: float = 1.0
    collision: float = 10.0
    off_road: float = 10.0

    def __call__(self, facts: StepFacts) -> float:
        """The weighted sum."""
        return float(sum(self.parts(facts).values()))

    def parts(self, facts: StepFacts) -> Mapping[str, float]:
        """The terms of the sum by name."""
        return {
            "progress": self.progress * facts.progress,
            "collision": -self.collision * facts.collision,
            "off_road": -self.off_road * facts.off_road,
        }


def step_facts(
    rollout: Rollout,
    first: int,
    route: ReferenceRoute,
    route_s: ArrayLike,
    region: shapely.Geometry | None,
    route_end: bool,
) -> StepFacts:
    """The facts of the states after `first`, by the metrics' own functions.

    Args:
        rollout: rollout up to now.
        first: step at the last observation.
        route_s: coordinates (S+1,) of the ego on the route.
        region: drivable area, see `recast.logs.hdmap`; None without a map.
        route_end: whether the ego came to the end of the route.
    """
    new, dt = slice(first + 1, None), rollout.dt
    boxes, size = rollout.ego_boxes[new], rollout.ego_size
    actors = [(rollout.actor, rollout.actor_size)]
    actors += [(actor.states, actor.size) for actor in rollout.controlled]
    hit = any_collision([no_collision(boxes, size, states[new], box, dt) for states, box in actors])
    distance = drivable_area_compliance(boxes, size, region, dt)
    s = np.asarray(route_s, np.float64)[[first, -1]]
    lateral = float(route.project(rollout.ego[-1], s[1])[1])
    return StepFacts(
        steps=len(boxes),
        seconds=len(boxes) * dt,
        progress=float(s[1] - s[0]),
        lateral=lateral,
        speed=float(rollout.ego[-1, 3]),
        collision=bool(np.any(hit.overlap > TOUCHING)),
        overlap=float(hit.overlap.max()),
        off_road=distance.dac.value == 0.0,
        off_road_distance=0.0 if distance.distance is None else float(distance.distance.max()),
        route_end=route_end,
    )


NOTHING = StepFacts(0, 0.0, 0.0, 0.0, 0.0, False, 0.0, False, 0.0, False)
"""The facts of a step in which nothing could be executed."""


TERMINATIONS = ("collision", "off_road")
_OPTIONS = ("scenario", "actors", "start_timestamp_us")


class DrivingEnv(gymnasium.Env[dict[str, Any], NDArray[np.float32]]):
    """One rollout an episode: the agent drives the ego.

    A step of the environment is `plan_every` steps of the simulation, 0.5 s by default. The episode
    terminates where the ego comes to the end of the route, and at what `terminate` names. It is
    truncated where the log ends, all `steps` were run, or an actor leaves the recorded road. `info`
    has every member of `StepFacts`, the terms of the reward if it has `parts`, and at the end
    `ending`, `cut_reason` and `metrics`. See `observation` for what the agent sees, `action_space`
    for what it does.

    In a vector environment every process loads log and scene itself: memory is scene times workers.

    Args:
        log: a log, or its folder.
        scene: scene as for `Simulator`, or the folder of a scene.
        actors: controlled actors by track id, with motions or their names; the first is the target.
        settings: how the rollouts are run, as for `Simulator`.
        action: "waypoints" (40, 3), or "controls": acceleration and steering rate (2,).
        cameras, scale, device: the same as for `Simulator`.
        reward: function that gives a number for what happened; None for `ProgressReward()`.
        terminate: which of "collision" and "off_road" end the episode.
        most_actors: number of rows of `actors` in the observation; further road users are left out.
        render_mode: "rgb_array" for `render`, which needs a scene, or None.

    Raises:
        InputError: bad arguments, see `Simulator`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self,
        log: DrivingLog | str | Path,
        scene: StreetScene | SensorRenderer | str | Path | None = None,
        actors: Mapping[str, str | Path | AnyMotion | Scenario] | None = None,
        settings: RolloutSettings | None = None,
        *,
        action: ActionKind = "waypoints",
        cameras: Sequence[str] | None = None,
        scale: float = 1.0,
        device: str = "auto",
        reward: Reward | None = None,
        terminate: Collection[str] = TERMINATIONS,
        most_actors: int = 16,
        render_mode: str | None = None,
    ) -> None:
        settings = settings or RolloutSettings()
        _check(action, terminate, most_actors, render_mode, settings)
        self._log = load_log(log) if isinstance(log, str | Path) else log
        self._renderer = as_renderer(self._log, _scene(scene), cameras, scale, device)
        self._kind, self._controls = action, HeldControls()
        if action == "controls":
            settings = replace(settings, controller=self._controls)
        self._actors, self._cameras, self._settings = dict(actors or {}), cameras, settings
        self._reward = whole(reward or ProgressReward(), BaseReward)
        self._terminate = frozenset(terminate)
        self._most_actors, self.render_mode = most_actors, render_mode
        self._simulator = self._make({})
        self._options: Mapping[str, Any] = {}
        self._over = True
        setup = self._simulator.setup
        self._history = history_length(setup.dt)
        self._region = drivable_region(setup.hdmap)
        self.action_space = action_space(action)
        mounts = self._simulator.context.cameras
        fps = 1.0 / (setup.plan_every * setup.dt)
        self.metadata = {**self.metadata, "render_fps": fps}
        self.observation_space = observation_space(mounts, self._history, most_actors)
        if not mounts:
            self.metadata = {**self.metadata, "render_modes": []}
            if render_mode is not None:
                raise InputError("DrivingEnv", "render_mode", "needs cameras", "give a scene")

    @property
    def simulator(self) -> Simulator:
        """The simulator of this episode."""
        return self._simulator

    @property
    def rollout(self) -> Rollout:
        """What was driven in this episode.

        Raises:
            ValueError: no step was executed yet.
        """
        return self._simulator.rollout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: seed of the environment's random numbers. The same seed gives the same bytes.
            options: "scenario", the target's motion in this episode; "actors", all of them; and
                "start_timestamp_us".

        Raises:
            InputError: an unknown option, or see `Simulator`.
        """
        super().reset(seed=seed)
        options = options or {}
        for name in options:
            if name not in _OPTIONS:
                mend = f"choose one of {', '.join(_OPTIONS)}"
                raise InputError("DrivingEnv", f"option {name}", "is not known", mend)
        if options != self._options:
            self._simulator, self._options = self._make(options), dict(options)
        seen = self._simulator.reset(seed=int(self.np_random.integers(2**31)))
        self._over = False
        return self._observation(seen), self._info(NOTHING)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drive `plan_every` steps of the simulation.

        Raises:
            InputError: the action has another shape or is not finite, the episode is over, or a
                motion returned no state.
        """
        if self._over:
            raise InputError("DrivingEnv", "step", "the episode is over", "call reset")
        simulator, first = self._simulator, self._simulator.step_number
        simulator.advance(self._plan(checked_action(action, self._kind)))
        route_end = simulator.ending is Ending.EGO
        facts = NOTHING
        if simulator.step_number > first:
            route = simulator.context.route
            along = simulator.route_s
            facts = step_facts(simulator.rollout, first, route, along, self._region, route_end)
        terminated = route_end or any(facts.to_info()[name] for name in self._terminate)
        truncated = simulator.done and not terminated
        self._over = terminated or truncated
        info = self._info(facts)
        if self._over:
            info |= self._last_info()
        reward = float(self._reward(facts))
        return self._observation(simulator.observe()), reward, terminated, truncated, info

    def render(self) -> Image | None:
        """The cameras side by side, (H, W, 3) uint8; None without a render mode."""
        names = tuple(self._simulator.context.cameras)
        if self.render_mode is None:
            return None
        images = self._simulator.render(names)
        height = min(image.shape[0] for image in images.values())
        return np.concatenate([images[name][:height] for name in names], axis=1)

    def close(self) -> None:
        """End what the renderer holds."""
        if self._renderer is not None:
            self._renderer.close()

    def _make(self, options: Mapping[str, Any]) -> Simulator:
        actors = dict(options.get("actors", self._actors))
        if "scenario" in options and actors:
            actors[next(iter(actors))] = options["scenario"]
        start = options.get("start_timestamp_us", self._settings.start_timestamp_us)
        settings = replace(self._settings, start_timestamp_us=start)
        return Simulator(self._log, self._renderer, actors, settings, cameras=self._cameras)

    def _plan(self, action: NDArray[np.float64]) -> Plan:
        if self._kind == "waypoints":
            return Plan(action)
        self._controls.command = action
        setup, now = self._simulator.setup, self._simulator.state.ego
        return self._controls.plan(now, setup.vehicle, setup.dt)

    def _observation(self, seen: Any) -> dict[str, Any]:
        route = self._simulator.context.route
        return observation(seen, route, self._history, self._most_actors)

    def _info(self, facts: StepFacts) -> dict[str, Any]:
        simulator = self._simulator
        return {
            **facts.to_info(),
            "step": simulator.step_number,
            "timestamp_us": simulator.state.timestamp_us,
            "reward_parts": dict(self._reward.parts(facts)),
        }

    def _last_info(self) -> dict[str, Any]:
        simulator = self._simulator
        metrics = {}
        if simulator.step_number > 0:
            found = rollout_metrics(simulator.rollout, simulator.setup.hdmap)
            metrics = {
                name: metric.value
                for name, metric in found.values.items()
                if metric.value is not None
            }
        ending = simulator.ending
        return {
            "ending": "terminated" if ending is None else str(ending),
            "cut_reason": simulator.cut_reason or "",
            "metrics": metrics,
        }


def _check(
    action: str,
    terminate: Collection[str],
    most_actors: int,
    render_mode: str | None,
    settings: RolloutSettings,
) -> None:
    def refuse(field: str, value: object, mend: str) -> None:
        raise InputError("DrivingEnv", field, f"is {value!r}", mend)

    if action not in KINDS:
        refuse("action", action, f"choose one of {', '.join(KINDS)}")
    if action == "controls" and settings.controller != RolloutSettings().controller:
        refuse("controller", settings.controller, "leave it out with action='controls'")
    if isinstance(terminate, str) or not set(terminate) <= set(TERMINATIONS):
        refuse("terminate", terminate, f"give a list of names from {', '.join(TERMINATIONS)}")
    if not 1 <= most_actors <= 1000:
        refuse("most_actors", most_actors, "give 1 to 1000")
    if render_mode not in (None, "rgb_array"):
        refuse("render_mode", render_mode, "choose 'rgb_array' or None")


def _scene(
    scene: StreetScene | SensorRenderer | str | Path | None,
) -> StreetScene | SensorRenderer | None:
    if not isinstance(scene, str | Path):
        return scene
    from recast.scene.store import load_scene  # needs torch

    return load_scene(scene)
