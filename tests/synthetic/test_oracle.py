"""The oracle, alone and in several processes."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.synthetic.world import World, make_rig
from recast.synthetic.write import Oracle, OraclePool


@pytest.fixture(scope="module")
def oracle(small: World) -> Oracle:
    return Oracle(small)


def shown(oracle: Oracle, poses: dict[str, np.ndarray] | None, time: int | None = None) -> set[int]:
    """Instances in the three cameras of the first pose."""
    found: set[int] = set()
    for mounted in make_rig(64, 48).cameras.values():
        pose = oracle.world.ego.poses[0] @ mounted.rig_from_camera
        frame = oracle.render(mounted.camera, pose, poses, time)
        found.update(np.unique(frame.instance).tolist())
    return found


def test_the_street_has_its_parked_cars_and_no_moving_ones(oracle: Oracle) -> None:
    parked = {oracle.instance_of(k) for k, v in oracle.world.vehicles.items() if v.parked}
    moving = {oracle.instance_of(k) for k, v in oracle.world.vehicles.items() if not v.parked}
    found = shown(oracle, {})
    assert found & parked
    assert not found & moving


def test_a_vehicle_is_where_it_is_put(oracle: Oracle) -> None:
    target, world = oracle.world.target, oracle.world
    ahead = world.ego.poses[0].copy()
    ahead[:3, 3] += 14.0 * ahead[:3, 0] + [0.0, 0.0, world.vehicles[target].model.size[2] / 2]
    mounted = make_rig(64, 48).cameras["front"]
    frame = oracle.render(
        mounted.camera, world.ego.poses[0] @ mounted.rig_from_camera, {target: ahead}
    )
    mask = frame.instance == oracle.instance_of(target)
    columns = np.nonzero(mask)[1]
    assert np.mean(columns) == pytest.approx(31.5, abs=1.5)
    rear = 14.0 - world.vehicles[target].model.size[0] / 2 - 1.54
    assert np.median(frame.depth[mask]) == pytest.approx(rear, abs=0.1)


def test_a_parked_car_can_be_moved_away(oracle: Oracle) -> None:
    before = shown(oracle, {})
    seen = [key for key in oracle.world.vehicles if oracle.instance_of(key) in before]
    far = np.eye(4)
    far[:3, 3] = [-90.0, 0.0, 0.8]
    assert oracle.instance_of(seen[0]) not in shown(oracle, {seen[0]: far})


def test_without_poses_it_shows_the_log(oracle: Oracle) -> None:
    world = oracle.world
    time = int(world.ego.timestamps_us[0])
    logged = {key: vehicle.trajectory.poses[0] for key, vehicle in world.vehicles.items()}
    assert shown(oracle, None, time) == shown(oracle, logged)
    assert oracle.instance_of(world.target) in shown(oracle, None, time)
    with pytest.raises(ValueError, match="timestamp_us"):
        shown(oracle, None)


def test_a_vehicle_that_is_not_there(oracle: Oracle) -> None:
    with pytest.raises(InputError, match="choose one of target"):
        shown(oracle, {"9": np.eye(4)})


def test_a_pool_gives_results_in_order_and_passes_errors_on(small: World) -> None:
    with OraclePool(small, 1) as pool:
        assert list(pool.map(_named, [3, 1, 2])) == ["target 3", "target 1", "target 2"]
        with pytest.raises(InputError, match="is odd"):
            list(pool.map(_fail, [2, 3]))


def _named(oracle: Oracle, job: int) -> str:
    return f"{oracle.world.target} {job}"


def _fail(oracle: Oracle, job: int) -> int:
    if job % 2:
        raise InputError("job", str(job), "is odd", "choose an even one")
    return job


_UNGUARDED = """
from recast.core.errors import InputError
from recast.synthetic.write import OraclePool

with OraclePool(bytes(5_000_000), workers=2) as pool:
    try:
        list(pool.map(len, [1, 2]))
    except InputError as error:
        print(error)
"""


def test_a_script_that_cannot_be_imported_anew_is_told_and_does_not_hang() -> None:
    """Read from standard input, it has no file that the processes could start from."""
    done = subprocess.run(
        [sys.executable, "-"], input=_UNGUARDED, capture_output=True, text=True, timeout=60
    )
    assert "guard a script's start" in done.stdout
