"""A planner on an empty plane: where does it go?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.geometry import se2
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.planning import Planner
from recast.simulation.ego_controller import EgoController, LqrController
from recast.simulation.motions import Stationary
from recast.simulation.rollout_loop import run_rollout
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]

_ROAD = 400.0
"""Metres of made-up straight log, long enough that nothing is cut."""


def probe_path(
    planner: Planner,
    *,
    speed: float = 8.0,
    steps: int = 40,
    controller: EgoController | None = None,
) -> Array:
    """Drive a planner that needs no images in a closed loop, to see that its frames are right.

    A log is made up for it: straight on at constant speed, and one vehicle that stands far away.
    Give your adapter a model that plans straight on, a left arc and a right arc: on the left arc y
    and heading must grow, on the right one fall.

    Args:
        planner: as it would be given to `run_rollout`.
        speed: m/s at the start.
        steps: of 0.1 s.
        controller: executes the plans; None for the default one.

    Returns:
        (steps + 1, 3) x, y, heading of the rear axle in the frame of the start.

    Raises:
        Exception: see `run_rollout`.
    """
    times = np.arange(round(_ROAD / speed * 10) + 1)
    start = np.array([30.0, -20.0, 0.7])  # not the origin, so that frames cannot be mistaken
    along = np.zeros((len(times), 3))
    along[:, 0] = 0.1 * speed * times
    drive = Trajectory(times.astype(np.int64) * 100_000, se2.to_se3(se2.compose(start, along)))
    parked = se2.to_se3(se2.compose(start, [0.0, 60.0, 0.0]))
    stands = Trajectory(drive.timestamps_us[[0, -1]], np.stack([parked, parked]))
    log = DrivingLog(
        "probe", {}, {}, drive, {"0": Track("0", "car", np.array([4.2, 1.8, 1.5]), stands)}
    )
    setup = RolloutSetup(
        log,
        "0",
        Stationary("a", min_gap=200.0, braking=4.0, reserve=0.0),
        start_timestamp_us=2_000_000,
        steps=steps,
        controller=controller or LqrController(),
    )
    states = run_rollout(setup, planner).ego
    return se2.relative(states[0, ego.POSE], states[:, ego.POSE])
