"""Rendered depth against LiDAR points whose place is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from recast.cameras import PinholeCamera
from recast.geometry import se2, se3
from recast.logs import DrivingLog, LidarStream, LidarSweep, Trajectory
from recast.reconstruction.scores import DepthScore, SweepsOfImages, depth_score, mean_depth
from recast.reconstruction.views import TrainingView
from recast.scene import SceneImage

CAMERA = PinholeCamera(60, 40, 50.0, 50.0, 30.0, 20.0)
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
WALL_M = 10.0


def wall_log(*times_us: int) -> DrivingLog:
    """A wall 10 m before a standing car; every sweep sees 200 points of it."""
    y, z = np.meshgrid(np.linspace(-4, 4, 20), np.linspace(-3, 3, 10))
    points = np.stack([np.full(200, WALL_M), y.ravel(), z.ravel()], -1).astype(np.float32)
    sweeps = [LidarSweep(time, points, np.zeros(200, np.float32)) for time in times_us]
    standing = Trajectory(np.array([0, 1_000_000]), se2.to_se3(np.zeros((2, 3))))
    lidar = LidarStream("top", np.eye(4), np.array(times_us, np.int64), sweeps)
    return DrivingLog("wall", {}, {"top": lidar}, standing, {})


def view(time_us: int) -> TrainingView:
    image = np.zeros((40, 60, 3), np.uint8)
    return TrainingView("front", 0, time_us, CAMERA, se3.inverse(AHEAD), image, None, True)


def rendered(depth: float, alpha: float = 1.0) -> SceneImage:
    shape = (40, 60)
    cover = np.full(shape, alpha, np.float32)
    return SceneImage(np.zeros((*shape, 3), np.float32), cover * np.float32(depth), cover)


def test_depth_is_that_of_the_surface_not_weighted_with_its_opacity() -> None:
    sweeps = SweepsOfImages(wall_log(500_000), {}).at(510_000)
    assert depth_score(rendered(WALL_M, 0.7), view(510_000), sweeps, {}) == DepthScore(
        200,
        0.0,
        pytest.approx(0, abs=1e-5),
        pytest.approx(0, abs=1e-5),
        pytest.approx(0, abs=1e-6),
        10.0,
    )


def test_errors_and_holes() -> None:
    sweeps = SweepsOfImages(wall_log(500_000), {}).at(500_000)
    image = rendered(WALL_M + 0.5)
    image.depth[:20] += 2.0  # the upper half of the wall is further off still
    image.alpha[:, :30] = 0.4  # half of it is not there
    score = depth_score(image, view(500_000), sweeps, {})
    assert score is not None and score.points == 200
    assert score.missing == pytest.approx(0.5)
    assert score.mean_abs_m == pytest.approx(1.5, abs=1e-5)
    assert score.mean_relative == pytest.approx(0.15, abs=1e-6)
    assert depth_score(rendered(1.0, 0.2), view(500_000), sweeps, {}) is None


def test_the_sweep_of_the_moment_is_taken_and_no_other() -> None:
    log = wall_log(400_000, 500_000, 600_000)
    sweeps = SweepsOfImages(log, {})
    assert [s.timestamp_us for s in sweeps.at(520_000)] == [500_000]
    assert sweeps.at(725_000) == []


class Counted(list[LidarSweep]):
    """Sweeps that remember which of them were read."""

    def __init__(self, sweeps: Iterable[LidarSweep]) -> None:
        super().__init__(sweeps)
        self.read: list[int] = []

    def __getitem__(self, index: int) -> LidarSweep:  # type: ignore[override]
        self.read.append(index)
        return super().__getitem__(index)


def test_the_cameras_of_a_moment_share_its_sweeps() -> None:
    plain = wall_log(400_000, 500_000, 600_000)
    second = replace(
        plain.lidars["top"], name="low", timestamps_us=np.array([460, 560, 660]) * 1000
    )
    both = replace(plain, lidars={"low": second, "top": plain.lidars["top"]})
    counted = {name: Counted(stream.sweeps) for name, stream in both.lidars.items()}
    lidars = {name: replace(s, sweeps=counted[name]) for name, s in both.lidars.items()}
    sweeps = SweepsOfImages(replace(both, lidars=lidars), {})
    for time in (390_000, 400_000, 415_000, 490_000, 500_000, 515_000, 620_000):
        alone = SweepsOfImages(both, {}).at(time)
        found = sweeps.at(time)
        assert [s.timestamp_us for s in found] == [s.timestamp_us for s in alone]
        image = rendered(WALL_M + 0.2)
        assert depth_score(image, view(time), found, {}) == depth_score(
            image, view(time), alone, {}
        )
    assert {name: stream.read for name, stream in counted.items()} == {
        "top": [0, 1, 2],
        "low": [0, 1, 2],
    }


def test_means_are_over_images() -> None:
    assert mean_depth([]) is None
    scores = [DepthScore(10, 0.0, 0.1, 0.2, 0.01, 0.0), DepthScore(90, 0.5, 0.3, 0.4, 0.03, 9.0)]
    assert mean_depth(scores) == DepthScore(
        100, 0.25, pytest.approx(0.2), pytest.approx(0.3), pytest.approx(0.02), 4.5
    )
