"""States of a synthetic world, and streets of Gaussians that stand in it."""

from __future__ import annotations

import numpy as np
import torch

from recast.cameras import CameraMount
from recast.geometry import se2
from recast.logs import Trajectory
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from recast.simulation import SimState
from recast.splats import Gaussians
from recast.synthetic.world import World


def state_of(world: World, step: int) -> SimState:
    """The logged state with all other moving vehicles."""
    poses = {k: v.trajectory.poses[step] for k, v in world.vehicles.items() if not v.parked}
    actor = poses.pop(world.target)
    return SimState(
        step=step,
        timestamp_us=int(world.ego.timestamps_us[step]),
        ego=np.zeros(11),
        log_ego=np.zeros(4),
        world_from_rig=world.ego.poses[step],
        track_id=world.target,
        actor=np.append(se2.from_se3(actor), 9.0),
        world_from_actor=actor,
        others=poses,
    )


GREY = (0.6, 0.6, 0.6)


def ball(colour: tuple[float, float, float], at: np.ndarray, size: float) -> Gaussians:
    return Gaussians(
        means=torch.from_numpy(np.asarray(at)[None]).float(),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        log_scales=torch.full((1, 3), float(np.log(size))),
        logit_opacities=torch.tensor([12.0]),
        sh=((torch.tensor(colour) - 0.5) / 0.28209479).reshape(1, 1, 3),
    )


def street(world: World, background: Gaussians, vehicle: Gaussians | None = None) -> StreetScene:
    """A grey sky around a background, with a model of the target."""
    own = ball((0.0, 1.0, 0.0), np.zeros(3), 0.5) if vehicle is None else vehicle
    target = world.vehicles[world.target]
    times, poses = world.ego.timestamps_us[[0, -1]], target.trajectory.poses[[0, -1]]
    actor = SceneActor(world.target, own, np.array([4.0, 1.8, 1.5]), Trajectory(times, poses))
    return StreetScene(background, {world.target: actor}, SkyMap.constant(torch.tensor(GREY)))


def at_camera(state: SimState, mount: CameraMount, metres: float) -> np.ndarray:
    """The place that far ahead of the camera, towards the target."""
    camera = (state.world_from_rig @ mount.rig_from_camera)[:3, 3]
    towards = state.world_from_actor[:3, 3] - camera
    return camera + metres * towards / np.linalg.norm(towards)
