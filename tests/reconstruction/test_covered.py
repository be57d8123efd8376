"""The road where a vehicle stood in all images is like the road before and behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import DrivingLog, Trajectory
from recast.reconstruction.covered import shown_behind, without_leftovers
from recast.reconstruction.views import TrainingView
from recast.scene import StreetScene
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.splats import Gaussians
from recast.splats.gaussians import C0
from support.synthetic_drives import drive

CAMERA = PinholeCamera(96, 64, 60.0, 60.0, 48.0, 20.0)
LOOKS_AHEAD = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 1.6]
)
COVERED = 6.0, 8.0
"""Metres ahead of the start between which a vehicle stands on the left half of the road."""


def flat(points: np.ndarray, colours: np.ndarray, sigma: tuple[float, float, float]) -> Gaussians:
    count = len(points)
    return Gaussians(
        means=torch.from_numpy(points.astype(np.float32)),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        log_scales=torch.log(torch.tensor(sigma)).repeat(count, 1),
        logit_opacities=torch.full((count,), 6.0),
        sh=torch.from_numpy(((colours - 0.5) / C0).astype(np.float32))[:, None],
    )


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return drive(5.0, 10.0)


@pytest.fixture(scope="module")
def views(log: DrivingLog) -> list[TrainingView]:
    times = log.world_from_rig.timestamps_us[:6].tolist()
    return [
        TrainingView("front", i, t, CAMERA, log.world_from_rig.at(t) @ LOOKS_AHEAD)
        for i, t in enumerate(times)
    ]


@pytest.fixture(scope="module")
def scene(log: DrivingLog) -> StreetScene:
    """A grey road with a white line on the left; purple, and a purple blob above it, where an
    opaque vehicle stands in all images, though it moves off later."""
    x, y = np.meshgrid(np.arange(4.0, 30.0, 0.25), np.arange(-2.0, 2.01, 0.25))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
    colours = np.where(np.abs(points[:, 1:2] - 1.0) < 0.1, 0.9, np.full((len(points), 3), 0.3))
    hidden = (points[:, 0] > COVERED[0]) & (points[:, 0] < COVERED[1]) & (points[:, 1] > 0.0)
    colours[hidden] = (0.5, 0.0, 0.6)
    blob = np.array([[7.0, 1.0, 0.4]])
    road = flat(
        np.concatenate([points, blob]), np.concatenate([colours, [[0.5, 0.0, 0.6]]]), (0.15,) * 3
    )
    times = log.world_from_rig.timestamps_us[[0, 10, -1]]
    places = [np.eye(4), np.eye(4), se3.from_rotation_translation(np.eye(3), [40.0, 0.0, 0.0])]
    x, y, z = np.meshgrid(
        np.arange(5.0, 9.01, 0.2), np.arange(-0.6, 2.61, 0.2), np.arange(0.1, 1.4, 0.2)
    )
    body = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)
    car = SceneActor(
        "7",
        flat(body, np.full((len(body), 3), 0.7), (0.2,) * 3),
        np.array([4.0, 3.0, 1.5]),
        Trajectory(times, np.stack(places)),
    )
    unseen = torch.zeros(len(road.means), dtype=torch.bool)
    return StreetScene(road, {"7": car}, SkyMap.constant(torch.ones(3)), unseen=unseen)


def colours_of(scene: StreetScene) -> np.ndarray:
    return scene.background.sh[:, 0].numpy() * C0 + 0.5


def test_contributions_are_those_of_the_images(
    scene: StreetScene, views: list[TrainingView]
) -> None:
    behind, beside = shown_behind(scene, views, ["7"])
    shown = behind + beside
    assert 0 < shown.sum() <= len(views) * CAMERA.width * CAMERA.height + 1
    x, y, _ = scene.background.means.numpy().T
    under = (x > 6.4) & (x < 7.6) & (y > 0.4) & (y < 1.6)
    far = (x < 6.0) & (y < -1.5)
    assert (beside[under] < 0.05 * behind[under] + 0.05).all()
    assert (behind[far] < 0.05 * beside[far] + 0.05).all()


def test_the_covered_road_is_like_the_road_before_and_behind(
    scene: StreetScene, log: DrivingLog, views: list[TrainingView]
) -> None:
    made = without_leftovers(scene, log, views)
    assert made.unseen is not None and scene.unseen is not None
    changed = made.unseen.numpy() & ~scene.unseen.numpy()
    x, y, z = made.background.means.numpy().T
    sure = (x > 6.2) & (x < 7.8) & (y > 0.3) & (y < 1.8) & (z == 0)
    assert changed[sure].all()
    # Only what shows nowhere else is touched.
    old, new = colours_of(scene), colours_of(made)
    np.testing.assert_array_equal(new[~changed], old[~changed])
    line = changed & (np.abs(y - 1.0) < 0.1) & (x < 8.0)
    plain = changed & (np.abs(y - 1.0) > 0.4) & (x < 8.0)
    assert line.any() and plain.any()
    assert np.abs(new[plain] - 0.3).max() < 0.1, "grey, and not purple"
    assert new[line].min() > 0.55, "the line goes on"
    assert float(made.background.logit_opacities[-1]) < -10, "the blob is gone"
    assert float(scene.background.logit_opacities[-1]) > 0, "the given scene is as it was"


def test_without_a_moving_vehicle_nothing_is_done(
    scene: StreetScene, log: DrivingLog, views: list[TrainingView]
) -> None:
    empty = replace(scene, actors={})
    assert without_leftovers(empty, log, views) is empty
