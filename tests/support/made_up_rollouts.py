"""Made-up rollouts for the tests of metrics."""

from __future__ import annotations

import numpy as np

from recast.geometry import se2
from recast.logs.hdmap import HdMap
from recast.simulation.rollout import Rollout

DT = 0.1


def straight_plans(count, speed):
    plans = np.zeros((count, 40, 3))
    plans[..., 0] = speed * DT * np.arange(1, 41)
    return plans


def make_rollout(
    ego=None, actor=None, predictions=None, *, steps=160, speed=5.0, arm="native", **changes
):
    """An ego driving straight along x at `speed`; the actor stands 10 m to its left."""
    states = steps + 1
    if ego is None:
        ego = np.zeros((states, 11))
        ego[:, 0] = speed * DT * np.arange(states)
        ego[:, 3] = speed
    if actor is None:
        actor = np.tile([20.0, 10.0, 0.0, 0.0], (len(ego), 1))
    states = len(ego)
    plan_steps = np.arange(0, states - 1, 5, dtype=np.int64)
    if predictions is None:
        predictions = straight_plans(len(plan_steps), speed)
    values = {
        "name": "made-up",
        "arm": arm,
        "track_id": "7",
        "motion": "stationary",
        "setting": "a",
        "planner": "constant_velocity",
        "start_timestamp_us": 1_000_000,
        "dt": DT,
        "steps_requested": 160,
        "cut_reason": None,
        "ego": ego,
        "log_ego": ego[:, :4],
        "actor": actor,
        "world_from_rig": se2.to_se3(ego[:, :3]),
        "world_from_actor": se2.to_se3(actor[:, :3], 0.8),
        "actor_size": np.array([4.5, 1.9, 1.6]),
        "ego_size": np.array([5.176, 2.297]),
        "ego_centre_offset": 1.461,
        "predictions": predictions,
        "plan_steps": plan_steps,
        "route": np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=-1),
    }
    rollout = Rollout(**{**values, **changes})
    rollout.validate()
    return rollout


def street(half_width=20.0, length=200.0):
    outline = np.array(
        [[-20, -half_width], [length, -half_width], [length, half_width], [-20, half_width]]
    )
    return HdMap(lanes={}, drivable_area=(outline.astype(float),))


def moved_rollout(rollout, move):
    """The same rollout in a world frame displaced by the planar pose `move`."""

    def shift(poses):
        shifted = np.array(poses, copy=True)
        shifted[:, :3] = se2.compose(move, shifted[:, :3])
        return shifted

    route = np.concatenate([rollout.route, np.zeros((len(rollout.route), 1))], axis=1)
    ego, actor = shift(rollout.ego), shift(rollout.actor)
    return make_rollout(
        ego,
        actor,
        rollout.predictions,
        log_ego=shift(rollout.log_ego),
        route=se2.compose(move, route)[:, :2],
        plan_steps=rollout.plan_steps,
        actor_size=rollout.actor_size,
    )


def moved_map(hd_map, move):
    outlines = []
    for outline in hd_map.drivable_area:
        poses = np.concatenate([outline, np.zeros((len(outline), 1))], axis=1)
        outlines.append(se2.compose(move, poses)[:, :2])
    return HdMap(lanes={}, drivable_area=tuple(outlines))
