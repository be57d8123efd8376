"""A NAVSIM agent as a planner; trajectories at any interval become waypoints at the simulator's."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.core.plugins import PLANNERS, code_source
from recast.planning.cameras import require_cameras
from recast.planning.simple import PROBE_CURVATURES, arc
from recast.planning.types import WAYPOINTS, BasePlanner, Plan, PlannerInput, PlanningContext
from recast_bridges.navsim.agent_input import InputBuilder, navsim_classes
from recast_bridges.navsim.types import (
    HISTORY_FRAMES,
    NAVSIM_CAMERAS,
    AgentInput,
    SensorConfig,
    Trajectory,
    TrajectorySampling,
    rig_cameras,
)
from recast_bridges.splines import spline_through

_SAME_TIME = 1e-6


@runtime_checkable
class NavsimAgent(Protocol):
    """What is used of NAVSIM's `AbstractAgent`."""

    def initialize(self) -> None:
        """Load weights."""

    def get_sensor_config(self) -> Any:
        """Which cameras are wanted in which frames, see `SensorConfig`."""

    def compute_trajectory(self, agent_input: Any) -> Any:
        """`AgentInput` to `Trajectory`."""


class NavsimPlanner(BasePlanner):
    """Drives what a NAVSIM agent answers; initialises it once, at once.

    Trajectories at other intervals than the simulator's are interpolated, see `resample`; of longer
    ones the first 4 s are used.

    Args:
        agent: has `initialize`, `get_sensor_config` and `compute_trajectory`.
        cameras: NAVSIM name to the rig's camera, such as `NUPLAN_RIG`; None to take those that look
            in the same direction.
        name: name for tables and file names; None for the agent's.

    Raises:
        InputError: the object is no agent; the agent wants what is not simulated (LiDAR, the scene
            with its future) or a camera that NAVSIM does not have; `installed_classes` without the
            package.
    """

    def __init__(
        self,
        agent: Any,
        *,
        cameras: Mapping[str, str] | None = None,
        name: str | None = None,
        installed_classes: bool | None = None,
    ) -> None:
        self.name = name or _agent_name(agent)
        if not isinstance(agent, NavsimAgent):
            methods = ("initialize", "get_sensor_config", "compute_trajectory")
            missing = [method for method in methods if not hasattr(agent, method)]
            raise InputError(
                self._who,
                type(agent).__name__,
                f"lacks {', '.join(missing)}",
                "name a class or function that returns a NAVSIM agent",
            )
        if getattr(agent, "requires_scene", False):
            raise InputError(
                self._who,
                "requires_scene",
                "is true: the agent needs the recorded future",
                "use an agent that needs only its AgentInput",
            )
        self.agent = agent
        self._classes = navsim_classes(installed_classes)
        agent.initialize()
        self._frames = _wanted_frames(agent.get_sensor_config(), self._who)
        self.needs_images = bool(self._frames)
        self._given = cameras
        if cameras is not None:
            require_cameras(self._frames, cameras, self._who)
            self.camera_names = tuple(cameras[name] for name in self._frames)
        self._builder: InputBuilder | None = None
        self._times = 0.1 * np.arange(1, WAYPOINTS + 1)

    @property
    def _who(self) -> str:
        return f"planner {self.name}"

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        """NAVSIM name to the rig's camera that stands for it. Raises InputError: see
        `rig_cameras`."""
        return self._match(mounts)

    def reset(self, context: PlanningContext) -> None:
        """Forget the past. Raises InputError: a camera is not there; see also `InputBuilder`."""
        cameras = self._match(context.cameras)
        require_cameras(cameras.values(), context.cameras, self._who)
        self._builder = InputBuilder(context, cameras, self._frames, self._classes, self._who)
        self._times = context.dt * np.arange(1, WAYPOINTS + 1)

    def plan(self, observation: PlannerInput) -> Plan:
        """The agent's trajectory.

        Raises:
            RuntimeError: `reset` was not called.
            InputError: the answer is no trajectory, is not finite, or ends too early.
        """
        if self._builder is None:
            raise RuntimeError("NavsimPlanner.plan: call reset first")
        answer = self.agent.compute_trajectory(self._builder.build(observation))
        try:
            poses, interval = answer.poses, float(answer.trajectory_sampling.interval_length)
        except (AttributeError, TypeError):
            raise InputError(
                self._who,
                "compute_trajectory",
                f"returned {type(answer).__name__}",
                "return a Trajectory with poses and trajectory_sampling",
            ) from None
        try:
            return Plan(resample(poses, interval, self._times))
        except ValueError as error:
            raise InputError(
                self._who,
                "compute_trajectory",
                str(error),
                "return finite poses x, y, heading that reach 4 s",
            ) from None

    def _match(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        if self._given is not None:
            return {name: self._given[name] for name in self._frames}
        return rig_cameras(tuple(self._frames), mounts, self._who)


def _agent_name(agent: Any) -> str:
    """The agent's own name, or its class's, fit for file names."""
    name = getattr(agent, "name", None)
    name = name() if callable(name) else name
    if not isinstance(name, str) or not name:
        name = type(agent).__name__
    return re.sub(r"[^\w.+-]+", "-", name)


def _wanted_frames(config: Any, where: str) -> dict[str, tuple[int, ...]]:
    """NAVSIM camera name to the frames, 0 .. 3, in which it is wanted; those never wanted left out.
    Raises InputError: the LiDAR is wanted, or a frame that there is not."""
    if getattr(config, "lidar_pc", False):
        raise InputError(
            where,
            "lidar_pc",
            "is requested, but LiDAR is not simulated",
            "use an agent that needs only cameras, or no sensors",
        )
    wanted: dict[str, tuple[int, ...]] = {}
    for name in NAVSIM_CAMERAS:
        frames = getattr(config, name, False)
        if isinstance(frames, bool):
            frames = range(HISTORY_FRAMES) if frames else ()
        wanted[name] = tuple(int(frame) for frame in frames)
        bad = [frame for frame in wanted[name] if not 0 <= frame < HISTORY_FRAMES]
        if bad:
            raise InputError(
                where,
                f"sensor config, {name}",
                f"requests frame {bad[0]}",
                f"request frames 0 (oldest) to {HISTORY_FRAMES - 1} (now)",
            )
    return {name: frames for name, frames in wanted.items() if frames}


def resample(poses: ArrayLike, interval: float, times: ArrayLike) -> Array:
    """Waypoints (M, 3) at `times` from poses (N, 3) that are `interval` seconds apart.

    The splines (see `spline_through`) go through the present pose at 0 and all the given ones.
    Poses that have the asked times are returned as they are.

    Args:
        poses: x, y, heading in the present ego frame at interval, 2 interval, ...
        times: (M,) seconds from now, none later than the last pose.

    Raises:
        ValueError: the poses end before `times`, or are not finite (N, 3).
    """
    try:
        poses = np.asarray(poses, np.float64)
    except (TypeError, ValueError):
        raise ValueError("its poses are not an array of numbers") from None
    times = np.asarray(times, np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise ValueError(f"its poses have shape {poses.shape}, not (N, 3)")
    if not np.isfinite(poses).all():
        first = int(np.argmax(~np.isfinite(poses).all(axis=1)))
        raise ValueError(f"pose {first} holds NaN or infinity")
    if not (np.isfinite(interval) and interval > 0):
        raise ValueError(f"the interval of its poses is {interval} s, not more than 0")
    knots = interval * np.arange(len(poses) + 1)
    if knots[-1] < times[-1] - _SAME_TIME:
        raise ValueError(
            f"its {len(poses)} poses every {interval:g} s end at {knots[-1]:g} s, "
            f"but {times[-1]:g} s are needed"
        )
    if len(poses) >= len(times) and np.allclose(
        knots[1 : len(times) + 1], times, rtol=0, atol=_SAME_TIME
    ):
        return poses[: len(times)].copy()
    return spline_through(knots, np.concatenate([np.zeros((1, 3)), poses]), times)


def navsim_planner(agent: str, device: str = "cpu") -> NavsimPlanner:
    """The planner of a NAVSIM agent.

    Args:
        agent: "package.module:attribute" of a class or function that returns it.
        device: given to that if it has a parameter of this name.

    Raises:
        InputError: the agent cannot be imported, or it cannot be simulated. Other exceptions of
            its code pass.
    """
    return NavsimPlanner(PLANNERS.make(agent, device=device))


def navsim_source(agent: str) -> str:
    """What stands for a NAVSIM agent in keys of artefacts: its name and the hash of its code."""
    return code_source(f"navsim:{agent}", PLANNERS.source_files(agent))


# NAVSIM agents whose motion is known in advance, to prove frame conventions.
#
# Each can be named, as `navsim:recast_bridges.navsim.planner:left_arc_agent`.


class ProbeAgent:
    """Drives an arc at its present speed.

    Args:
        name: one of `PROBE_CURVATURES`.
        interval: seconds between the poses it answers with.
    """

    def __init__(self, name: str, interval: float = 0.5) -> None:
        self.name = name
        self._curvature = PROBE_CURVATURES[name]
        self._sampling = TrajectorySampling(time_horizon=4.0, interval_length=interval)

    def initialize(self) -> None:
        """Nothing to load."""

    def get_sensor_config(self) -> SensorConfig:
        """It needs no sensors."""
        return SensorConfig.build_no_sensors()

    def compute_trajectory(self, agent_input: AgentInput) -> Trajectory:
        """The arc for the coming 4 s."""
        speed = float(agent_input.ego_statuses[-1].ego_velocity[0])
        assert self._sampling.num_poses is not None and self._sampling.interval_length is not None
        times = self._sampling.interval_length * np.arange(1, self._sampling.num_poses + 1)
        return Trajectory(arc(self._curvature, speed * times).astype(np.float32), self._sampling)


straight_agent = partial(ProbeAgent, "straight")
left_arc_agent = partial(ProbeAgent, "left-arc")
right_arc_agent = partial(ProbeAgent, "right-arc")
