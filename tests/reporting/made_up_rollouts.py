"""Small made-up rollouts and maps: what a cut-in looks like without a simulator."""

from __future__ import annotations

import dataclasses

import numpy as np

from recast.geometry import se2
from recast.logs.hdmap import HdMap, Lane
from recast.simulation.rollout import Rollout

STEPS = 30
HOSTILE = "<script>alert('x')</script> & \"../..\"\n"
"""A name as it should not be: markup, quotes, a path, a line break."""


def straight_map(length: float = 160.0, lane_width: float = 3.6) -> HdMap:
    """Two lanes along x."""
    lanes = {}
    for name, offset in (("right", 0.0), ("left", lane_width)):
        x = np.linspace(-20.0, length, 40)
        sides = {}
        for side, lateral in (
            ("left", lane_width / 2),
            ("centre", 0.0),
            ("right", -lane_width / 2),
        ):
            sides[side] = np.stack([x, np.full_like(x, offset + lateral), np.zeros_like(x)], axis=1)
        lanes[name] = Lane(
            name,
            sides["centre"],
            sides["left"],
            sides["right"],
            np.concatenate([sides["right"][:, :2], sides["left"][::-1, :2]]),
        )
    outline = np.array([[-20.0, -3.0], [length, -3.0], [length, 7.0], [-20.0, 7.0]])
    return HdMap(lanes, (outline,), derived=True)


def cut_in(
    arm: str = "native", *, brake: float = 0.0, steps: int = 80, cut: bool = True
) -> Rollout:
    """An ego at 9 m/s that brakes by `brake` m/s^2; an actor ahead that moves into its lane."""
    dt = 0.1
    time = np.arange(steps + 1) * dt
    speed = np.maximum(9.0 - brake * time, 0.0)
    x = np.concatenate([[0.0], np.cumsum(speed[:-1] * dt)])
    ego = np.zeros((steps + 1, 11))
    ego[:, 0], ego[:, 3] = x, speed
    ego[:, 5] = np.gradient(speed, dt)
    log_ego = np.stack(
        [9.0 * time, np.zeros_like(time), np.zeros_like(time), np.full_like(time, 9.0)], 1
    )
    u = np.clip((time - 0.5) / 2.5, 0, 1)
    lateral = 3.5 * (1 - (10 * u**3 - 15 * u**4 + 6 * u**5))
    actor_speed = np.maximum(7.2 - 0.6 * time, 4.0)
    actor_x = 12.0 + np.concatenate([[0.0], np.cumsum(actor_speed[:-1] * dt)])
    heading = np.arctan2(np.gradient(lateral, dt), actor_speed)
    actor = np.stack([actor_x, lateral, heading, actor_speed], 1)
    plan_steps = np.arange(0, steps, 5)
    ahead = np.arange(1, 41) * dt
    predictions = np.zeros((len(plan_steps), 40, 3))
    for n, k in enumerate(plan_steps):
        stop = speed[k] / brake if brake > 0 else np.inf
        t = np.minimum(ahead, stop)
        predictions[n, :, 0] = speed[k] * t - brake * t**2 / 2
    return Rollout(
        name=f"cut-in-a-{arm}",
        arm=arm,
        track_id="0",
        motion="cut-in",
        setting="a",
        planner="idm-lane-follower",
        start_timestamp_us=1_000_000,
        dt=dt,
        steps_requested=160 if cut else steps,
        cut_reason="the recorded road ends 8.0 s after the start" if cut else None,
        ego=ego,
        log_ego=log_ego,
        actor=actor,
        world_from_rig=se2.to_se3(ego[:, :3]),
        world_from_actor=se2.to_se3(actor[:, :3], 0.8),
        actor_size=np.array([4.3, 1.8, 1.5]),
        ego_size=np.array([5.176, 2.297]),
        ego_centre_offset=1.461,
        predictions=predictions,
        plan_steps=plan_steps,
        route=np.stack([np.linspace(0, 140, 60), np.zeros(60)], 1),
    )


def turned(rollout: Rollout, pose: tuple[float, float, float]) -> Rollout:
    """The same rollout elsewhere in the world."""
    frame = np.array(pose)
    ego, log_ego, actor = rollout.ego.copy(), rollout.log_ego.copy(), rollout.actor.copy()
    for states in (ego, log_ego, actor):
        states[:, :3] = se2.compose(frame, states[:, :3])
    route = se2.compose(frame, np.c_[rollout.route, np.zeros(len(rollout.route))])[:, :2]
    return dataclasses.replace(rollout, ego=ego, log_ego=log_ego, actor=actor, route=route)
