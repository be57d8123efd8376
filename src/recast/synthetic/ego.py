"""The ego's own drive along its route."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.errors import InputError
from recast.synthetic.lane_path import LanePath
from recast.synthetic.routes import extended_route
from recast.synthetic.speed import SpeedProfile, speed_profile
from recast.synthetic.streets import EGO_START
from recast.synthetic.world import Street

Array = NDArray[np.float64]

LENGTH, WIDTH, CENTRE_OFFSET = 5.176, 2.297, 1.461
"""Outline of the ego, and how far its middle is ahead of the rear axle, metres; nuPlan's car."""

_ROAD_AHEAD = 60.0
"""Metres of road needed past the end of a drive, for vehicles ahead of the ego."""


@dataclass(frozen=True)
class EgoDrive:
    """A drive of the rear axle along a path.

    Attributes:
        path: the route's centreline, with all the road before and after.
        profile: speed by place on it.
        start: metres along the path at time 0.
        seconds: (T,) times of the log's poses.
    """

    path: LanePath
    profile: SpeedProfile
    start: float
    seconds: Array

    def place(self, seconds: ArrayLike) -> Array:
        """Arc lengths (...) of the rear axle, also before and after the log."""
        return self.profile.drive(self.start, seconds)

    @property
    def poses(self) -> Array:
        """(T, 3) planar poses of the rig."""
        return self.path.poses(self.place(self.seconds))

    @property
    def outline(self) -> Array:
        """(T, 3) planar poses of the middle of the ego's outline, `LENGTH` x `WIDTH`."""
        poses = self.poses
        ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(len(poses))], axis=-1)
        return poses + CENTRE_OFFSET * ahead

    @property
    def mean_speed(self) -> float:
        """m/s over the log."""
        ends = self.place(self.seconds[[0, -1]])
        return float((ends[1] - ends[0]) / (self.seconds[-1] - self.seconds[0]))


def ego_drive(street: Street, seconds: Array, rng: np.random.Generator) -> EgoDrive:
    """The drive along `street.ego_route`, from `EGO_START` metres after its beginning.

    Args:
        seconds: (T,) times of poses.

    Raises:
        InputError: the street is too short for the drive.
    """
    path = LanePath.along(street.map, extended_route(street.map, street.ego_route))
    profile = speed_profile(path, street.ego_speed, rng)
    first = street.map.lanes[street.ego_route[0]].centreline[0, :2]
    start = float(path.line.to_frenet(first)[0]) + EGO_START
    drive = EgoDrive(path, profile, start, seconds)
    end = float(drive.place(seconds[-1]))
    if end + _ROAD_AHEAD > path.length:
        raise InputError(
            street.kind,
            "ego_route",
            f"has {path.length:.0f} m where {end + _ROAD_AHEAD:.0f} m are needed",
            "ask for fewer seconds",
        )
    return drive
