"""Tracks of given poses in a log, and a motion that returns what it is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.simulation import MotionInput, StartSituation

DT = 0.1


def with_track(log: DrivingLog, key: str, poses: NDArray, first: int = 0) -> DrivingLog:
    """The log with a car (K, 3) from its step `first` on, 0.1 s apart."""
    times = log.world_from_rig.timestamps_us[first : first + len(poses)]
    trajectory = Trajectory(times, se2.to_se3(np.asarray(poses, float), 0.75))
    car = Track(key, "car", np.array([4.0, 1.8, 1.5]), trajectory)
    return replace(log, tracks={**log.tracks, key: car})


def line(start: tuple[float, float, float], speed: float, count: int = 201) -> NDArray:
    """Poses along the heading."""
    steps = np.zeros((count, 3))
    steps[:, 0] = speed * DT * np.arange(count)
    return se2.compose(np.array(start), steps)


class Bad:
    """A user's motion that reacts, and at step 7 returns something."""

    name, setting = "bad", "a"

    def __init__(self, value: object, at: int = 7) -> None:
        self.value, self.at = value, at

    def start(self, situation: StartSituation) -> object:
        good = np.append(situation.route.pose(situation.ahead(20.0)), 1.0)
        return self.value if self.at == 0 else good

    def step(self, state: MotionInput, dt: float) -> object:
        return self.value if state.step + 1 == self.at else state.state
