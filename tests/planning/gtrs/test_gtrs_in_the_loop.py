"""GTRS behind the simulator's seam."""

from __future__ import annotations

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs import DrivingLog, Track, Trajectory
from recast.planning.gtrs import GtrsPlanner
from recast.simulation import MOTIONS, NullRenderer, RolloutSetup, run_rollout
from support.tiny_gtrs import rig


@pytest.fixture
def log() -> DrivingLog:
    """Twenty seconds straight on at 10 m/s, and a parked car."""
    times = np.arange(201, dtype=np.int64)
    poses = np.stack([times, np.zeros(201), np.zeros(201)], axis=-1).astype(np.float64)
    drive = Trajectory(times * 100_000, se2.to_se3(poses))
    parked = Trajectory(drive.timestamps_us, se2.to_se3(np.tile([5.0, 40.0, 0.0], (201, 1))))
    car = Track("7", "car", np.array([4.2, 1.8, 1.5]), parked)
    return DrivingLog("straight", {}, {}, drive, {"7": car})


def test_a_rollout_drives_entries_of_the_vocabulary(planner: GtrsPlanner, log: DrivingLog) -> None:
    setup = RolloutSetup(log, "7", MOTIONS["advancing-a"], steps=10)
    rollout = run_rollout(setup, planner, NullRenderer(rig("a", "b", "c")))
    again = run_rollout(setup, planner, NullRenderer(rig("a", "b", "c", scale=2)))
    np.testing.assert_array_equal(again.predictions, rollout.predictions)  # black either way
    assert rollout.planner == "tiny" and len(rollout.predictions) == 2
    for prediction in rollout.predictions:
        assert (planner.vocabulary == prediction.astype(np.float32)).all(axis=(1, 2)).any()


def test_a_rig_without_its_cameras_is_refused(planner: GtrsPlanner, log: DrivingLog) -> None:
    setup = RolloutSetup(log, "7", MOTIONS["advancing-a"], steps=10)
    with pytest.raises(InputError, match=r"planner tiny: view front: is ahead, .* no camera"):
        run_rollout(setup, planner, NullRenderer(rig("front_left")))
