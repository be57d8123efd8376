"""A motion by places and times in the world of one log, as other simulators' scenarios have it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np

from recast.arrays import Array
from recast.geometry import se2
from recast.logs.checks import WORLD_REACH
from recast.simulation.actor_motion import Quantity, Rows, Scripted, StartSituation

_PLACE = Quantity("m", -WORLD_REACH, WORLD_REACH)
_PATH = Rows(
    Quantity("s", -1000.0, 1000.0), _PLACE, _PLACE, Quantity("rad", -10.0, 10.0), least=2
)  # fmt: skip


@dataclass(frozen=True)
class TimedPath(Scripted):
    """Is at given places at given times, whatever the road and the ego do.

    Positions and headings are linear between two rows. Before the first row and after the last one
    the velocity stays and the heading too.

    Attributes:
        path: rows of seconds after the start of the rollout, x, y and heading of the box centre in
            the world of the log.
        start_after: seconds after the log's first ego pose at which a rollout with this target
            starts; None for the usual start.

    Raises:
        ValueError: the times do not increase.
    """

    setting: str
    path: Annotated[tuple[tuple[float, float, float, float], ...], _PATH]
    start_after: Annotated[float | None, Quantity("s", 0.0, 100_000.0)] = None
    name: str = "timed-path"
    description: str = ""

    def __post_init__(self) -> None:
        times = [row[0] for row in self.path]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("path: its times do not increase; give each row a later time")

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4); the speed is that of the row before, or of the first two rows."""
        rows = np.array(self.path, np.float64)
        times, places = rows[:, 0], rows[:, 1:3]
        velocity = np.diff(places, axis=0) / np.diff(times)[:, None]
        now = dt * np.arange(steps + 1)
        segment = np.clip(np.searchsorted(times, now, "right") - 1, 0, len(velocity) - 1)
        since = (now - times[segment])[:, None]
        xy = places[segment] + velocity[segment] * since
        heading = np.interp(now, times, np.unwrap(rows[:, 3]))
        speed = np.linalg.norm(velocity[segment], axis=1)
        return np.concatenate([xy, se2.wrap_angle(heading)[:, None], speed[:, None]], axis=1)
