"""The recorded road: nothing is simulated where nothing was recorded."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.errors import InputError
from recast.logs.types import Trajectory
from recast.planning import ReferenceRoute
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]

_MIN_CYCLES = 2
_BEHIND_START = 1.0
"""Metres that a position may lie before the route: a standing ego may roll back a little."""
_BESIDE_LOGGED = 2.0
"""Metres from its own logged path within which an actor that follows it is on recorded road."""


class Ending(StrEnum):
    """What ends a rollout."""

    STEPS = "steps"  # all that were asked for
    LOG = "log"  # the log ends
    ACTOR = "actor"  # a controlled actor came to the end of the recorded road
    EGO = "ego"  # the ego came to the end of its route
    EGO_BEFORE = "ego-before"  # the ego went back to before the beginning of its route


@dataclass(frozen=True)
class RecordedRoad:
    """Where one road user may be.

    Attributes:
        route: the ego's reference route.
        margin: metres before its end that are left free.
        own: (N, 2) the road user's own logged path, which counts as well; None if it does not.
    """

    route: ReferenceRoute
    margin: float
    own: Array | None = None

    @classmethod
    def of_actor(
        cls, route: ReferenceRoute, margin: float, follows_log: bool, logged: Trajectory
    ) -> RecordedRoad:
        """The road of a controlled actor; its own path counts if it follows that."""
        return cls(route, margin, logged.poses[:, :2, 3] if follows_log else None)

    def outside(self, points: Array) -> NDArray[np.bool_]:
        """Which points (..., 2) lie before the recorded road, or beyond its end less `margin`."""
        s, _ = self.route.project(points)
        outside: NDArray[np.bool_] = (s < -_BEHIND_START) | (s > self.route.length - self.margin)
        if self.own is not None and outside.any():
            outside = outside & (self._beside(points) > _BESIDE_LOGGED)
        return outside

    def ending(self, point: Array) -> Ending:
        """How the rollout ends if the ego comes to `point` (2,) outside of the road."""
        return Ending.EGO_BEFORE if float(self.route.project(point)[0]) < 0 else Ending.EGO

    def reason(self, who: str, point: Array) -> str:
        """Why a rollout is cut where `who` would come to `point` (2,)."""
        if self.own is not None:
            metres = float(self._beside(point))
            return (
                f"{who} would leave the recorded road: it would be {metres:.1f} m from its "
                "logged path"
            )
        s = float(self.route.project(point)[0])
        if s < 0:
            return f"{who} would leave the recorded road {-s:.1f} m before its start"
        return (
            f"{who} would leave the recorded road: it would be at {s:.1f} m of "
            f"{self.route.length:.1f} m, closer than {self.margin:g} m to its end"
        )

    def _beside(self, points: Array) -> Array:
        """Metres (...) from points (..., 2) to the own path."""
        assert self.own is not None
        path = shapely.points(self.own[0]) if len(self.own) == 1 else shapely.linestrings(self.own)
        metres: Array = shapely.distance(path, shapely.points(points))
        return metres


def who(setup: RolloutSetup, track_id: str) -> str:
    """A controlled actor as reasons and errors call it."""
    return "the actor" if track_id == setup.track_id else f"actor {track_id}"


def refuse_if_too_short(setup: RolloutSetup, steps: int, reason: str | None) -> None:
    """Refuse a rollout of which a cut leaves less than two plan cycles.

    Raises:
        InputError: names the reason of the cut.
    """
    needed = min(_MIN_CYCLES * setup.plan_every, setup.steps)
    if steps < needed:
        raise InputError(
            setup.log.name,
            f"rollout {setup.name}",
            f"{reason}, which leaves {max(steps, 0)} of {setup.steps} steps "
            f"where at least {needed} are needed",
            "choose an earlier start, another motion or setting, or a longer log",
        )
