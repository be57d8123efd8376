"""A planner and a renderer that keep what they are asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.cameras import CameraMount, PinholeCamera
from recast.planning import ConstantVelocity, Plan, PlannerInput, PlanningContext
from recast.simulation import NullRenderer, SimState

MOUNTS = {
    "front": CameraMount(PinholeCamera(8, 4, 5.0, 5.0, 4.0, 2.0), np.eye(4)),
    "left": CameraMount(PinholeCamera(6, 4, 5.0, 5.0, 3.0, 2.0), np.eye(4)),
}


class Recorder:
    """A planner that drives straight on and keeps what it saw."""

    name = "recorder"

    def __init__(self, needs_images: bool = False) -> None:
        self.needs_images = needs_images
        self.inner = ConstantVelocity()
        self.seen: list[PlannerInput] = []
        self.context: PlanningContext | None = None

    def reset(self, context: PlanningContext) -> None:
        self.context = context
        self.seen = []
        self.inner.reset(context)

    def plan(self, observation: PlannerInput) -> Plan:
        self.seen.append(observation)
        return self.inner.plan(observation)


class CountingRenderer(NullRenderer):
    def __init__(self) -> None:
        super().__init__(MOUNTS)
        self.states: list[SimState] = []

    def render(self, state: SimState, camera_names: object) -> dict[str, NDArray[np.uint8]]:
        self.states.append(state)
        return super().render(state, camera_names)
