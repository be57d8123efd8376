"""The planner that comes with the package: whole, small, and it looks at the pictures."""

from __future__ import annotations

import numpy as np
import pytest

from recast.cameras import CameraMount
from recast.dynamics import PACIFICA, make_state
from recast.planning import (
    DrivingCommand,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    make_planner,
    shipped_folder,
)
from recast.planning.gtrs import GtrsPlanner
from recast.synthetic import make_rig, make_world
from recast.synthetic.world import World, exposure
from recast.synthetic.write import Oracle

pytest.importorskip("embreex")

SPEED = 9.0
SHIPPED = ("gtrs-mini", "gtrs-mini-oracle")


@pytest.fixture(scope="module")
def world() -> World:
    """One that it was not trained on: evaluation's seeds are small, the training's are not."""
    return make_world("urban-straight", 2, 4.0)


def looking(world: World, gap: float | None) -> dict[str, np.ndarray]:
    """Pictures at half the size of runs, with a car standing `gap` metres ahead, or none."""
    world_from_rig, poses = world.ego.poses[3], {}
    if gap is not None:
        size = world.vehicles[world.target].model.size
        pose = world_from_rig.copy()
        ahead = PACIFICA.length / 2 + PACIFICA.centre_offset + gap + size[0] / 2
        pose[:3, 3] += ahead * pose[:3, 0]
        pose[2, 3] += size[2] / 2
        poses[world.target] = pose
    oracle, rng = Oracle(world), np.random.default_rng(0)
    return {
        name: oracle.render(
            mounted.camera,
            world_from_rig @ mounted.rig_from_camera,
            poses,
            exposure=exposure(world.seed, name),
            rng=rng,
        ).rgb
        for name, mounted in make_rig(240, 160).cameras.items()
    }


@pytest.mark.parametrize("name", SHIPPED)
def test_it_is_whole_and_small(name: str) -> None:
    assert isinstance(make_planner(name), GtrsPlanner)
    assert sum(path.stat().st_size for path in shipped_folder(name).rglob("*")) < 5e6


@pytest.mark.parametrize("name", SHIPPED)
def test_it_drives_less_far_the_nearer_a_car_stands(world: World, name: str) -> None:
    planner = make_planner(name)
    mounts = {
        k: CameraMount(m.camera, m.rig_from_camera) for k, m in make_rig(240, 160).cameras.items()
    }
    route = ReferenceRoute.from_trajectory(world.ego)
    planner.reset(PlanningContext(route, world.ego, cameras=mounts))
    state = make_state(np.zeros(3), speed=SPEED)
    metres = []
    for gap in (None, 25.0, 12.0):
        seen = PlannerInput(
            0, 0, state, state[None], (), DrivingCommand.STRAIGHT, looking(world, gap)
        )
        metres.append(float(planner.plan(seen).waypoints[-1, 0]))
    free, far, near = metres
    assert free > 20.0
    assert far < free - 3.0
    assert near < 12.0
