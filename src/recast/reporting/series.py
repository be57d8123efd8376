"""What happens over time in a rollout: speeds, the gap between the boxes, accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.geometry import boxes, se2
from recast.simulation.rollout import Rollout

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Per state k = 0..S of a rollout.

    Attributes:
        time: (S+1,) seconds from the start.
        ego_speed, log_ego_speed, actor_speed: (S+1,) m/s.
        acceleration: (S+1,) longitudinal, of the ego, m/s^2.
        lateral_acceleration: (S+1,) speed times yaw rate, m/s^2, positive to the left.
        gap: (S+1,) metres between the two boxes seen from above; 0 where they overlap.
        plan_time: (C,) seconds at which each plan was made.
    """

    time: Array
    ego_speed: Array
    log_ego_speed: Array
    actor_speed: Array
    acceleration: Array
    lateral_acceleration: Array
    gap: Array
    plan_time: Array

    @property
    def collision_step(self) -> int | None:
        """First state in which the boxes touch, or None."""
        steps = np.flatnonzero(self.gap <= 0.0)
        return int(steps[0]) if len(steps) else None


def series(rollout: Rollout) -> Series:
    """Curves of a rollout."""
    ego = rollout.ego
    return Series(
        time=np.arange(len(ego), dtype=np.float64) * rollout.dt,
        ego_speed=np.hypot(ego[:, 3], ego[:, 4]),
        log_ego_speed=rollout.log_ego[:, 3],
        actor_speed=rollout.actor[:, 3],
        acceleration=ego[:, 5],
        lateral_acceleration=ego[:, 3] * ego[:, 9],
        gap=_gap(rollout),
        plan_time=rollout.plan_steps.astype(np.float64) * rollout.dt,
    )


def planned_paths(rollout: Rollout) -> Array:
    """World points (C, 41, 2) of each plan, its own ego position first."""
    start = rollout.ego[rollout.plan_steps, :3]
    world = se2.compose(start[:, None, :], rollout.predictions)
    return np.concatenate([start[:, None, :2], world[..., :2]], axis=1)


def _gap(rollout: Rollout) -> Array:
    ego = boxes.bev_corners(rollout.ego_boxes, *rollout.ego_size)
    actor = boxes.bev_corners(rollout.actor[:, :3], *rollout.actor_size[:2])
    distance: Array = shapely.distance(shapely.polygons(ego), shapely.polygons(actor))
    return distance
