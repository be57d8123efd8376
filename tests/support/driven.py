"""Rollouts by a driver of AlpaSim: planner, setup, and pictures that change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from recast.arrays import Image
from recast.logs.types import DrivingLog
from recast.planning import Planner
from recast.simulation import (
    MOTIONS,
    Rollout,
    RolloutFailure,
    RolloutSetup,
    SimState,
    failure,
    run_rollout,
)
from recast.simulation.renderer import MountedRenderer
from recast_bridges.alpasim.driver import AlpaSimDriver
from support.synthetic_drives import drive

QUICK = (0.05, 0.05)
"""Seconds before each further try of a call."""


def planner_of(port: int, cameras: Any = (), **options: Any) -> AlpaSimDriver:
    """A planner of the driver at a port of this machine."""
    return AlpaSimDriver(f"127.0.0.1:{port}", cameras, **{"pauses": QUICK, **options})


def setup_of(log: DrivingLog | None = None, steps: int = 30, **options: Any) -> RolloutSetup:
    """A short drive at 10 m/s, unless another log is given."""
    log = drive() if log is None else log
    track = next(iter(log.tracks))
    return RolloutSetup(log, track, MOTIONS["advancing-a"], steps=steps, **options)


def failure_of(setup: RolloutSetup, planner: Planner) -> RolloutFailure:
    """The failure of a rollout, which must not end well."""
    result = attempt(setup, planner)
    assert isinstance(result, RolloutFailure)
    return result


def attempt(setup: RolloutSetup, planner: Planner) -> Rollout | RolloutFailure:
    """A rollout, or why there is none."""
    try:
        return run_rollout(setup, planner)
    except Exception as error:
        return failure(setup, planner.name, error)


class Noise(MountedRenderer):
    """Other pictures at each step: as dark as the ego has come far."""

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        images = {}
        for index, name in enumerate(camera_names):
            camera = self._mounts[name].camera
            generator = np.random.default_rng(10 * state.step + index)
            pixels = generator.integers(0, 255, (camera.height, camera.width, 3))
            images[name] = (pixels * (1.0 - state.step / 60.0)).astype(np.uint8)
        return images
