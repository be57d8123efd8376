"""Where everything is when a rollout starts: what a motion is scripted from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import Polyline, se2
from recast.logs.types import Trajectory
from recast.planning import ReferenceRoute

Array = NDArray[np.float64]

DEFAULT_LANE_OFFSET = 3.5
"""Metres to the neighbouring lane where the map knows none."""
_STRAIGHT = 1000.0
"""Metres of the made-up path of a vehicle that the log saw standing."""


@dataclass(frozen=True)
class StartSituation:
    """Where everything is when a rollout starts, as seen by one controlled actor.

    Attributes:
        route: the ego's reference route.
        ego_s: route coordinate of the ego's box centre, metres.
        ego_speed: m/s.
        ego_length: metres.
        actor_size: (3,) length, width, height of the actor's box, metres.
        neighbour_lateral: offset in metres, left positive, of the neighbouring lane of the same
            direction; None where there is none.
        track_id: of the actor.
        trajectory: `world_from_object` of the actor as the log has it; None if there is none.
        start_timestamp_us: log time of the start.
        seed: of the rollout, for motions that draw random numbers.
    """

    route: ReferenceRoute
    ego_s: float
    ego_speed: float
    ego_length: float
    actor_size: Array
    neighbour_lateral: float | None = None
    track_id: str = ""
    trajectory: Trajectory | None = None
    start_timestamp_us: int = 0
    seed: int = 0

    @property
    def reference_speed(self) -> float:
        """v_r: the ego's speed within [4, 12] m/s, which scales the moving motions."""
        return float(np.clip(self.ego_speed, 4.0, 12.0))

    @property
    def beside(self) -> float:
        """Lateral offset of a car in the next lane: the neighbour's, or 3.5 m to the left."""
        return DEFAULT_LANE_OFFSET if self.neighbour_lateral is None else self.neighbour_lateral

    def ahead(self, gap: float) -> float:
        """Route coordinate of the actor's centre, `gap` metres from the ego's front bumper."""
        return self.ego_s + gap + (self.ego_length + float(self.actor_size[0])) / 2

    def labelled(self) -> Trajectory:
        """The actor's logged trajectory, which covers the start.

        Raises:
            InputError: the log does not have the actor at the start.
        """
        track = self.trajectory
        if track is None or not track.covers(self.start_timestamp_us):
            problem = "has no logged trajectory"
            if track is not None:
                after = [(t - self.start_timestamp_us) * 1e-6 for t in track.timestamps_us[[0, -1]]]
                problem = (
                    "is not labelled at the start: its labels go from "
                    f"{after[0]:.1f} to {after[1]:.1f} s after it"
                )
            mend = "choose another start, track or motion"
            raise InputError("rollout", f"track {self.track_id}", problem, mend)
        return track

    @cached_property
    def own_path(self) -> ReferenceRoute:
        """The path that the log saw the actor drive, for its box centre; straight ahead of the pose
        at the start if it moved less than 4 m.

        Raises:
            InputError: see `labelled`.
        """
        track = self.labelled()
        try:
            return ReferenceRoute.from_trajectory(track)
        except InputError:
            pose = se2.from_se3(track.at(self.start_timestamp_us))
            end = se2.compose(pose, [_STRAIGHT, 0.0, 0.0])
            line = Polyline(np.stack([pose[:2], end[:2]]))
            return ReferenceRoute(line, np.full(2, pose[2]), np.zeros(2))
