"""The trajectory that a driver of AlpaSim answers with, checked, and as waypoints of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Int64Array
from recast.geometry import se2
from recast.logs.checks import LATEST_US
from recast_bridges.alpasim.poses import read_pose
from recast_bridges.splines import spline_through

_NEAR = 5.0
"""Metres from the ego at which a plan may begin: more is another frame."""
_FASTEST = 100.0
"""Metres per second that a plan without a pose for now may have driven until its first one."""


@dataclass(frozen=True)
class DrivenPlan:
    """A driver's trajectory.

    Attributes:
        timestamps_us: (N,) rising; N is at least 2.
        poses: (N, 3) x, y, heading of the rear axle, world.
    """

    timestamps_us: Int64Array
    poses: Array

    @classmethod
    def read(cls, trajectory: Any, now_us: int, ego_pose: ArrayLike) -> Self:
        """The plan of a message Trajectory that has poses.

        Args:
            ego_pose: (3,) pose of the ego now, world.

        Raises:
            ValueError: a pose is none, there is only one, times do not rise, or the plan lies in
                the past or far from the ego.
        """
        count = len(trajectory.poses)
        if count < 2:
            raise ValueError("the trajectory has one pose, at least two are needed")
        times = [pose.timestamp_us for pose in trajectory.poses]
        for index, time in enumerate(times):
            if not (times[index - 1] if index else -1) < time < LATEST_US:
                raise ValueError(f"poses[{index}].timestamp_us: is {time}, not a valid later time")
        if times[-1] <= now_us:
            raise ValueError(f"the trajectory ends {(now_us - times[-1]) * 1e-6:g} s before now")
        matrices = [
            read_pose(pose.pose, f"poses[{index}].pose")
            for index, pose in enumerate(trajectory.poses)
        ]
        plan = cls(np.array(times, np.int64), se2.from_se3(np.stack(matrices)))
        plan._require_near(now_us, np.asarray(ego_pose, np.float64))
        return plan

    def _require_near(self, now_us: int, ego_pose: Array) -> None:
        here = [np.interp(now_us, self.timestamps_us, self.poses[:, axis]) for axis in (0, 1)]
        apart = float(np.hypot(*(np.array(here) - ego_pose[:2])))
        late = max(int(self.timestamps_us[0]) - now_us, 0) * 1e-6
        if apart > _NEAR + _FASTEST * late:
            raise ValueError(f"the trajectory begins {apart:.1f} m from the ego")

    @property
    def ends_us(self) -> int:
        """Time of the last pose."""
        return int(self.timestamps_us[-1])

    def waypoints(self, now_us: int, ego_pose: ArrayLike, times_us: Int64Array) -> Array:
        """Waypoints (M, 3) in the ego frame.

        Poses at the asked times are taken as they are; else they are interpolated, see
        `spline_through`, from the ego's present pose on if the driver gave none for now. Beyond the
        last pose the ego goes on straight, at the velocity between the last two.

        Args:
            now_us: present time, earlier than `ends_us`.
            ego_pose: (3,) pose of the ego now, world.
            times_us: (M,) times of the waypoints, rising, later than now.
        """
        knots, poses = self.timestamps_us, se2.relative(ego_pose, self.poses)
        if knots[0] > now_us:
            knots = np.concatenate([[now_us], knots])
            poses = np.concatenate([np.zeros((1, 3)), poses])
        within = times_us <= knots[-1]
        inside, found = times_us[within], np.empty((len(times_us), 3))
        if np.isin(inside, knots).all():
            found[within] = poses[np.searchsorted(knots, inside)]
        else:
            found[within] = spline_through((knots - now_us) * 1e-6, poses, (inside - now_us) * 1e-6)
        velocity = (poses[-1, :2] - poses[-2, :2]) / (knots[-1] - knots[-2])
        beyond = (times_us[~within] - knots[-1])[:, None]
        found[~within, :2] = poses[-1, :2] + velocity * beyond
        found[~within, 2] = poses[-1, 2]
        return found
