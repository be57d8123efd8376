"""What happens over time in a rollout: speeds, the gap between the boxes, accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.evaluation.collision import TOUCHING, overlap_areas
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
        gap: (S+1,) metres between the two boxes seen from above; 0 where they overlap.
        contact: (S+1,) bool, whether they overlap, as NC counts it.
        plan_time: (C,) seconds at which each plan was made.
    """

    time: Array
    ego_speed: Array
    log_ego_speed: Array
    actor_speed: Array
    acceleration: Array
    gap: Array
    contact: NDArray[np.bool_]
    plan_time: Array

    @property
    def collision_step(self) -> int | None:
        """First state with contact, or None."""
        steps = np.flatnonzero(self.contact)
        return int(steps[0]) if len(steps) else None


def series(rollout: Rollout) -> Series:
    """Curves of a rollout."""
    ego = rollout.ego
    boxes_of_ego = rollout.ego_boxes
    actor = rollout.actor[:, :3]
    overlap = overlap_areas(boxes_of_ego, rollout.ego_size, actor, rollout.actor_size)
    distance = shapely.distance(
        shapely.polygons(boxes.bev_corners(boxes_of_ego, *rollout.ego_size)),
        shapely.polygons(boxes.bev_corners(actor, *rollout.actor_size[:2])),
    )
    return Series(
        time=np.arange(len(ego), dtype=np.float64) * rollout.dt,
        ego_speed=np.hypot(ego[:, 3], ego[:, 4]),
        log_ego_speed=rollout.log_ego[:, 3],
        actor_speed=rollout.actor[:, 3],
        acceleration=ego[:, 5],
        gap=np.asarray(distance, np.float64),
        contact=overlap > TOUCHING,
        plan_time=rollout.plan_steps.astype(np.float64) * rollout.dt,
    )


def planned_paths(rollout: Rollout) -> Array:
    """World points (C, 41, 2) of each plan, its own ego position first."""
    start = rollout.ego[rollout.plan_steps, :3]
    world = se2.compose(start[:, None, :], rollout.predictions)
    return np.concatenate([start[:, None, :2], world[..., :2]], axis=1)
