"""A closed-loop rollout with a planner that looks: seconds of computing for seconds driven.

    python benchmarks/rollout.py                              # 16 s, 3 cameras, 300k Gaussians
    python benchmarks/rollout.py --planner ./my-gtrs --gaussians 100000
    python benchmarks/rollout.py --planner pdm-closed --scene parked-street   # boxes alone

The street is made up, as dense as a reconstructed one, along a synthetic drive. The planner
decides on the pictures as in any rollout, but the log's own motion is driven, so that every planner
is timed on the same drive. Only the planner's cameras are rendered, and only when it plans. A
planner that needs no images gets the boxes of all the street's vehicles instead.
Times are wall-clock seconds.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from time import perf_counter

import numpy as np
import torch
from raster import street

from recast.cameras import CameraMount
from recast.geometry import se3
from recast.logs import Track
from recast.planning import (
    LogReplay,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
    looked_at,
    make_planner,
    planner_cameras,
)
from recast.scene import SceneActor, StreetScene
from recast.scene.sky import SkyMap
from recast.simulation import MOTIONS, RolloutSetup, Timings, run_rollout
from recast.simulation.scene_renderer import SceneRenderer
from recast.splats import Gaussians, set_threads
from recast.synthetic import make_rig
from recast_tools.planner_data.stage import SampleStage, make_stage

_GROUND = 1.6
"""Metres of the made-up street's camera above its ground."""
_LENGTH = 1.6
"""The street is that much longer than the rasterizer's benchmark has it, to carry 16 s."""
_ACTOR_SHARE = 0.1


class OnRails:
    """Asks another planner, and drives the log."""

    def __init__(self, planner: Planner) -> None:
        self.planner, self.replay = planner, LogReplay()
        self.name, self.needs_images = planner.name, planner.needs_images

    def reset(self, context: PlanningContext) -> None:
        """Both."""
        self.planner.reset(context)
        self.replay.reset(context)

    def plan(self, observation: PlannerInput) -> Plan:
        """The log's motion, after the other has planned."""
        self.planner.plan(observation)
        return self.replay.plan(observation)


def made_up_scene(stage: SampleStage, track: Track, count: int) -> StreetScene:
    """A street of `count` Gaussians along the drive, a tenth of them the actor's."""
    few = round(_ACTOR_SHARE * count)
    background = street(count - few, degree=1)
    stretch = torch.tensor([_LENGTH, 1.0, 1.0])
    background = replace(
        background,
        means=(background.means + torch.tensor([30.0, 0, _GROUND])) * stretch
        - torch.tensor([30.0, 0, 0]),
        log_scales=background.log_scales + float(np.log(_LENGTH)) / 2,
    )
    start = se3.from_rotation_translation(
        se3.rotation_z(float(se3.yaw(stage.log.world_from_rig.poses[0]))),
        stage.log.world_from_rig.poses[0][:3, 3],
    )
    generator = torch.Generator().manual_seed(1)
    half = torch.from_numpy(track.size / 2).float()
    actor = Gaussians(
        means=half * (2 * torch.rand(few, 3, generator=generator) - 1),
        quats=torch.randn(few, 4, generator=generator),
        log_scales=torch.full((few, 3), -3.5),
        logit_opacities=torch.full((few,), 2.0),
        sh=0.3 * torch.randn(few, 4, 3, generator=generator),
    )
    return StreetScene(
        background.transformed(torch.from_numpy(start)),
        {track.track_id: SceneActor(track.track_id, actor, track.size, track.trajectory)},
        SkyMap.constant(torch.tensor([0.6, 0.7, 0.9])),
    )


def main() -> None:
    """Print one line a rollout and the ratio to the time driven."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--planner", default="gtrs-mini", help="a planner of docs/planners.md")
    parser.add_argument("--scene", default="urban-straight", help="a street of recast.synthetic")
    parser.add_argument("--gaussians", type=int, default=300_000)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 320))
    parser.add_argument("--steps", type=int, default=160)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--repeats", type=int, default=3)
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    set_threads(chosen.threads)

    planner = make_planner(chosen.planner)
    stage = make_stage(chosen.scene, 0, seconds=20.0)
    vehicle = stage.world.vehicles[stage.world.target]
    track = Track(stage.world.target, "car", np.asarray(vehicle.model.size), vehicle.trajectory)
    tracks = {track.track_id: track}
    if not planner.needs_images:
        tracks |= {
            key: Track(key, "car", np.asarray(other.model.size), other.trajectory)
            for key, other in stage.world.vehicles.items()
            if key not in (*stage.actors, track.track_id)
        }
    log = replace(stage.log, tracks=tracks)
    mounts = {
        name: CameraMount(mounted.camera, mounted.rig_from_camera)
        for name, mounted in make_rig(*chosen.size).cameras.items()
    }
    mounts = looked_at(planner, mounts)
    setup = RolloutSetup(
        log,
        track.track_id,
        MOTIONS["oncoming-a"],
        steps=chosen.steps,
        traffic="replay",
        camera_names=planner_cameras(planner, mounts),
    )
    renderer = SceneRenderer(made_up_scene(stage, track, chosen.gaussians), mounts)
    print(
        f"{planner.name}, {len(tracks)} vehicles, {chosen.gaussians} Gaussians, "
        f"{len(setup.camera_names or ())} cameras {chosen.size[0]}x{chosen.size[1]}, "
        f"{chosen.threads} threads"
    )
    for _ in range(chosen.repeats):
        timings, began = Timings(), perf_counter()
        rollout = run_rollout(setup, OnRails(planner), renderer, timings=timings)
        seconds, driven = perf_counter() - began, (len(rollout.ego) - 1) * setup.dt
        plans = -(-(len(rollout.ego) - 1) // setup.plan_every)
        rest = seconds - timings.render - timings.plan - timings.control
        print(
            f"{driven:.1f} s driven in {seconds:.1f} s, ratio {seconds / driven:.2f}: rendering "
            f"{timings.render:.1f} s ({timings.frames} images), planning {timings.plan:.1f} s "
            f"({1e3 * timings.plan / plans:.0f} ms a plan), "
            f"control {timings.control:.1f} s, rest {rest:.1f} s"
        )


if __name__ == "__main__":
    main()
