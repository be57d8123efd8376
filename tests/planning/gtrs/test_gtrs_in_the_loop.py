"""GTRS behind the simulator's seam."""

from __future__ import annotations

import numpy as np
import pytest

from recast.errors import InputError
from recast.geometry import PinholeCamera, se2
from recast.logs import DrivingLog, Track, Trajectory
from recast.planning import CameraMount
from recast.planning.gtrs import GtrsPlanner, nuplan_rig
from recast.simulation import MOTIONS, NullRenderer, RolloutSetup, run_rollout

from .conftest import VIEWS


@pytest.fixture
def log() -> DrivingLog:
    """Twenty seconds straight on at 10 m/s, and a parked car."""
    times = np.arange(201, dtype=np.int64)
    poses = np.stack([times, np.zeros(201), np.zeros(201)], axis=-1).astype(np.float64)
    drive = Trajectory(times * 100_000, se2.to_se3(poses))
    parked = Trajectory(drive.timestamps_us, se2.to_se3(np.tile([5.0, 40.0, 0.0], (201, 1))))
    car = Track("7", "car", np.array([4.2, 1.8, 1.5]), parked)
    return DrivingLog("straight", {}, {}, drive, {"7": car})


def _renderer(names: tuple[str, ...], scale: int = 1) -> NullRenderer:
    camera = PinholeCamera(VIEWS.width, VIEWS.height, 40.0, 40.0, 24.0, 16.0)
    camera = camera.resized(scale * VIEWS.width, scale * VIEWS.height)
    mounts = nuplan_rig().values()
    return NullRenderer(
        {n: CameraMount(camera, m.rig_from_camera) for n, m in zip(names, mounts, strict=False)}
    )


def test_a_rollout_drives_entries_of_the_vocabulary(planner: GtrsPlanner, log: DrivingLog) -> None:
    setup = RolloutSetup(
        log, "7", MOTIONS["advancing-a"], steps=10, camera_names=planner.camera_names
    )
    rollout = run_rollout(setup, planner, _renderer(planner.camera_names))
    again = run_rollout(setup, planner, _renderer(planner.camera_names, scale=2))
    np.testing.assert_array_equal(again.predictions, rollout.predictions)  # black either way
    assert rollout.planner == "tiny" and len(rollout.predictions) == 2
    for prediction in rollout.predictions:
        assert (planner.vocabulary == prediction.astype(np.float32)).all(axis=(1, 2)).any()


def test_a_rig_without_its_cameras_is_refused(planner: GtrsPlanner, log: DrivingLog) -> None:
    setup = RolloutSetup(log, "7", MOTIONS["advancing-a"], steps=10, camera_names=("front",))
    with pytest.raises(InputError, match="planner tiny: camera front_left: is needed"):
        run_rollout(setup, planner, _renderer(("front",)))
