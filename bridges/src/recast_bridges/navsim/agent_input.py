"""What the simulator shows, in NAVSIM's form: in classes of the installed package, or in ours."""

from __future__ import annotations

import importlib
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.types import PlannerInput, PlanningContext, ego_status
from recast_bridges.navsim import types
from recast_bridges.navsim.types import HISTORY_FRAMES, HISTORY_INTERVAL, NAVSIM_CAMERAS

_MODULE = "navsim.common.dataclasses"

_INTERVAL_US = round(HISTORY_INTERVAL * 1e6)


class InputBuilder:
    """Builds the agent's input of one rollout, cycle by cycle.

    Where the log has no ego states before the start, constant velocity is assumed. Images exist at
    plan steps only; in frames before the first one they are those of the first.

    Args:
        cameras: NAVSIM name to the rig's camera.
        frames: NAVSIM name to the frames, 0 (oldest) .. 3 (now), in which the agent wants it.

    Raises:
        InputError: half a second is no whole number of steps; or the agent wants past images, and
            the plan steps do not fall on its frames.
    """

    def __init__(
        self,
        context: PlanningContext,
        cameras: Mapping[str, str],
        frames: Mapping[str, Sequence[int]],
        classes: NavsimClasses,
        where: str,
    ) -> None:
        self._context, self._cameras, self._frames = context, cameras, frames
        self._classes = classes
        self._stride = round(HISTORY_INTERVAL / context.dt)
        if abs(self._stride * context.dt - HISTORY_INTERVAL) > 1e-6:
            raise InputError(
                where,
                "dt",
                f"is {context.dt:g} s, which does not divide the history interval of "
                f"{HISTORY_INTERVAL} s",
                "simulate with dt 0.1",
            )
        past = {name for name, wanted in frames.items() if set(wanted) - {HISTORY_FRAMES - 1}}
        if past and self._stride % context.plan_every:
            raise InputError(
                where,
                f"camera {min(past)}",
                f"is needed every {HISTORY_INTERVAL} s, but rendered every "
                f"{context.plan_every * context.dt:g} s",
                "set plan_every to 5",
            )
        self._images: deque[tuple[int, Mapping[str, Image]]] = deque()

    def build(self, observation: PlannerInput) -> Any:
        """The `AgentInput` of this cycle; call once per cycle, in order."""
        now = observation.timestamp_us
        oldest = now - (HISTORY_FRAMES - 1) * _INTERVAL_US
        while self._images and self._images[0][0] < oldest:
            self._images.popleft()
        self._images.append((now, observation.images))
        make = self._classes
        return make.agent_input(
            ego_statuses=[self._status(observation, i) for i in range(HISTORY_FRAMES)],
            cameras=[self._cameras_at(now, i) for i in range(HISTORY_FRAMES)],
            lidars=[make.lidar() for _ in range(HISTORY_FRAMES)],
        )

    def _status(self, observation: PlannerInput, frame: int) -> Any:
        state = self._state(observation.ego_history, HISTORY_FRAMES - 1 - frame)
        present = frame == HISTORY_FRAMES - 1
        command = observation.command if present else self._context.route.command(state)
        numbers = ego_status(command, state)
        return self._classes.ego_status(
            ego_pose=se2.relative(observation.ego[ego.POSE], state[ego.POSE]).astype(np.float32),
            ego_velocity=numbers[4:6],
            ego_acceleration=numbers[6:8],
            driving_command=numbers[:4].astype(np.int64),
        )

    def _state(self, history: Array, ago: int) -> Array:
        """The ego state (11,) `ago` intervals before now."""
        back = ago * self._stride
        if back < len(history):
            return history[-1 - back]
        first = history[0].copy()
        missing = (back - len(history) + 1) * self._context.dt
        first[ego.POSE] = se2.compose(first[ego.POSE], [-first[ego.VX] * missing, 0.0, 0.0])
        first[ego.AX] = first[ego.ANGULAR_VELOCITY] = 0.0
        return first

    def _cameras_at(self, now: int, frame: int) -> Any:
        time = now - (HISTORY_FRAMES - 1 - frame) * _INTERVAL_US
        # The first images stand for all earlier ones.
        images = next((seen for at, seen in self._images if at >= time), self._images[-1][1])
        wanted = {name for name, frames in self._frames.items() if frame in frames}
        return self._classes.cameras(
            **{
                name: self._camera(name, images) if name in wanted else self._classes.camera()
                for name in NAVSIM_CAMERAS
            }
        )

    def _camera(self, name: str, images: Mapping[str, Image]) -> Any:
        mount: CameraMount = self._context.cameras[self._cameras[name]]
        intrinsics = mount.camera.matrix
        intrinsics[:2, 2] -= 0.5  # OpenCV counts from the centre of the first pixel
        return self._classes.camera(
            image=images[self._cameras[name]].copy(),  # agents make tensors of it
            sensor2lidar_rotation=mount.rig_from_camera[:3, :3].copy(),
            sensor2lidar_translation=mount.rig_from_camera[:3, 3].copy(),
            intrinsics=intrinsics,
            distortion=np.array(mount.camera.distortion),
        )


@dataclass(frozen=True)
class NavsimClasses:
    """Classes with NAVSIM's field names."""

    agent_input: Any
    camera: Any
    cameras: Any
    ego_status: Any
    lidar: Any

    @classmethod
    def of(cls, module: Any) -> NavsimClasses:
        """Those of a module that calls them as NAVSIM does."""
        return cls(module.AgentInput, module.Camera, module.Cameras, module.EgoStatus, module.Lidar)


def navsim_classes(installed: bool | None) -> NavsimClasses:
    """The classes to use.

    Args:
        installed: True for those of the `navsim` package, False for ours. None for the package's
            where it is loaded already, as it is when the agent's module imports it.

    Raises:
        InputError: the package's are asked for, and it cannot be imported.
    """
    if installed is None:
        installed = _MODULE in sys.modules
    if not installed:
        return NavsimClasses.of(types)
    try:
        return NavsimClasses.of(importlib.import_module(_MODULE))
    except ImportError as error:
        raise InputError(
            "navsim",
            "package",
            f"cannot be imported ({error})",
            "install it, or leave installed_classes out: agents need not import it",
        ) from None
