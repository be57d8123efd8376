"""The motion of an actor that does what the log saw it do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.logs.motion import logged_velocity
from recast.simulation.actor_motion import Scripted
from recast.simulation.situation import StartSituation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LogReplay(Scripted):
    """Drives as logged; after its last label it keeps speed and heading."""

    setting: str = "a"
    name: str = "log-replay"
    description: str = ""

    @property
    def follows_log(self) -> bool:
        """True: the actor was recorded wherever it is."""
        return True

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Logged poses (steps + 1, 4); speeds are differences over one step to each side.

        Raises:
            InputError: the log does not have the actor at the start.
        """
        track = start.labelled()
        step_us = round(dt * 1e6)
        times = start.start_timestamp_us + step_us * np.arange(steps + 1, dtype=np.int64)
        last = int(track.timestamps_us[-1])
        logged = np.minimum(times, last)
        poses = se2.from_se3(track.at(logged))
        velocity = logged_velocity(track, logged, step_us)
        late = times > last
        poses[late, :2] += velocity[late] * ((times - logged)[late] * 1e-6)[:, None]
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        return np.concatenate([poses, np.linalg.norm(velocity, axis=1)[:, None]], axis=1)
