"""The planner that comes with the package: whole, small, and it looks at the pictures."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

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
from recast.planning.registry import SHIPPED
from recast.synthetic import make_rig, make_world
from recast.synthetic.world import World, exposure
from recast.synthetic.write import Oracle

pytest.importorskip("embreex")

SPEED = 9.0


@pytest.fixture(scope="module")
def world() -> World:
    """One that it was not trained on: evaluation's seeds are small, the training's are not."""
    return make_world("urban-straight", 2, 4.0)


Looking = Callable[..., dict[str, np.ndarray]]


@pytest.fixture(scope="module")
def look(world: World) -> Looking:
    """`looking` in the world; planners share the pictures."""
    return cache(partial(looking, world, Oracle(world)))


def looking(
    world: World, oracle: Oracle, gap: float | None, back: float = 0.0, *, faces: bool = False
) -> dict[str, np.ndarray]:
    """Pictures at half the size of runs from `back` metres behind a place, with a car standing
    `gap` metres ahead, or none; it `faces` the ego or shows its rear."""
    world_from_rig, poses = world.ego.poses[20].copy(), {}
    if gap is not None:
        size = world.vehicles[world.target].model.size
        pose = world_from_rig.copy()
        ahead = PACIFICA.length / 2 + PACIFICA.centre_offset + gap + size[0] / 2
        pose[:3, 3] += (ahead - back) * pose[:3, 0]
        pose[2, 3] += size[2] / 2
        if faces:
            pose[:3, :2] *= -1.0
        poses[world.target] = pose
    world_from_rig[:3, 3] -= back * world_from_rig[:3, 0]
    rng = np.random.default_rng(0)
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
def test_it_drives_less_far_the_nearer_a_car_stands(world: World, look: Looking, name: str) -> None:
    free, far, near = (planned_metres(world, look, name, gap) for gap in (None, 25.0, 12.0))
    assert free > 20.0
    assert far < free - 3.0
    assert near < free - 12.0


@pytest.mark.parametrize("name", SHIPPED)
def test_it_stops_for_a_car_that_faces_it(world: World, look: Looking, name: str) -> None:
    assert planned_metres(world, look, name, 25.0, faces=True) < 25.0
    assert planned_metres(world, look, name, 12.0, faces=True) < 16.0


def planned_metres(
    world: World, look: Looking, name: str, gap: float | None, *, faces: bool = False
) -> float:
    """Metres that it plans to drive in 4 s at 9 m/s, a second after it first saw the car."""
    planner = make_planner(name)
    mounts = {
        k: CameraMount(m.camera, m.rig_from_camera) for k, m in make_rig(240, 160).cameras.items()
    }
    route = ReferenceRoute.from_trajectory(world.ego)
    planner.reset(PlanningContext(route, world.ego, cameras=mounts))
    state = make_state(np.zeros(3), speed=SPEED)
    for step, back in enumerate((1.0, 0.5, 0.0)):  # seconds
        metres_back = SPEED * back
        ahead = None if gap is None else gap + metres_back
        images = look(ahead, metres_back, faces=faces)
        seen = PlannerInput(
            step, 500_000 * step, state, state[None], (), DrivingCommand.STRAIGHT, images
        )
        plan = planner.plan(seen)
    return float(plan.waypoints[-1, 0])
