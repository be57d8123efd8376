"""What the columns of a picture show, and how it is read from their tokens."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import torch

from recast.dynamics import make_state
from recast.geometry import boxes, se2
from recast.planning.gtrs.expert import TargetObstacle
from recast.planning.gtrs.perception import COLUMN_SCALES, LOOKS_FROM
from recast.synthetic import make_rig
from recast_tools.planner_training.samples import COLUMNS, mirror_columns
from recast_tools.planner_training.targets import COLUMN_VALUES, column_values
from recast_tools.planner_training.task import (
    COLUMN_LOOKS,
    HALF_VIEWS,
    MINI_VIEWS,
    column_loss,
)
from support.target_roads import moving

DIRECTIONS = HALF_VIEWS.directions(COLUMNS)


def test_columns_look_from_left_to_right() -> None:
    assert DIRECTIONS.shape == (COLUMNS,)
    assert np.all(np.diff(DIRECTIONS) < 0)
    np.testing.assert_allclose(DIRECTIONS, -DIRECTIONS[::-1], atol=1e-6)
    assert np.deg2rad(55) < DIRECTIONS[0] < np.deg2rad(65)
    # Half as wide pictures show the same.
    np.testing.assert_allclose(DIRECTIONS, MINI_VIEWS.directions(COLUMNS), atol=1e-6)


def test_columns_look_where_the_rig_looks() -> None:
    """The pictures of the samples are cut from the rig's cameras."""
    found = []
    for view, (name, mounted) in zip(
        HALF_VIEWS.views,
        make_rig(HALF_VIEWS.width, HALF_VIEWS.height, HALF_VIEWS.cameras).cameras.items(),
        strict=True,
    ):
        assert view.name == name
        rays = mounted.camera.rays(mounted.camera.pixel_grid()[mounted.camera.height // 2])
        way = rays @ mounted.rig_from_camera[:3, :3].T
        cut = slice(view.crop_columns, HALF_VIEWS.width - view.crop_columns)
        found.append(np.unwrap(np.arctan2(way[:, 1], way[:, 0]))[cut])
    seen = np.concatenate(found).reshape(COLUMNS, -1).mean(axis=1)
    np.testing.assert_allclose(DIRECTIONS, seen, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_distances_are_those_of_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = make_state(rng.normal(0, 30, 3), 7.0)
    cars = []
    for index in range(6):
        place = [rng.uniform(4, 60), rng.uniform(-15, 15), rng.uniform(-3, 3)]
        pose = se2.compose(state[:3], place)
        poses = np.stack([pose, se2.compose(pose, [rng.uniform(0, 1.2), 0, 0])])
        cars.append(TargetObstacle(str(index), poses, np.array([4.5, 1.9])))
    found = column_values(state, cars, DIRECTIONS[:, None])
    eye = se2.compose(state[:3], [1.5, 0, 0])
    for values, angle in zip(found, DIRECTIONS, strict=True):
        far = eye[:2] + 70.0 * np.array([np.cos(eye[2] + angle), np.sin(eye[2] + angle)])
        ray = shapely.LineString([eye[:2], far])
        met = [
            ray.intersection(shapely.Polygon(boxes.bev_corners(car.poses[0], *car.size)))
            for car in cars
        ]
        away = [np.inf if m.is_empty else m.distance(shapely.Point(eye[:2])) for m in met]
        nearest = int(np.argmin(away))
        assert bool(values[0]) is bool(np.isfinite(away[nearest]))
        if not values[0]:
            assert not values.any()
            continue
        assert np.exp(values[1]) == pytest.approx(away[nearest], rel=1e-4)
        turned = cars[nearest].poses[0, 2] - state[2]
        np.testing.assert_allclose(values[2:4], [np.cos(turned), np.sin(turned)], atol=1e-6)
        moved = (cars[nearest].poses[1] - cars[nearest].poses[0])[:2] / 0.1
        own = 7.0 * np.array([np.cos(state[2]), np.sin(state[2])])
        seen = se2.relative([0, 0, state[2]], [*(moved - own), 0])[:2]
        np.testing.assert_allclose(values[4:], seen, atol=1e-4)


@pytest.mark.parametrize("ahead", [8.0, 20.0, 45.0])
def test_somebody_between_the_middles_of_two_columns_is_seen(ahead: float) -> None:
    np.testing.assert_allclose(COLUMN_LOOKS.mean(axis=1), DIRECTIONS, atol=1e-9)
    state, missed = make_state(np.zeros(3), 6.0), 0
    for aside in np.arange(-6.0, 6.0, 0.1):
        pose = np.array([ahead, aside, np.pi / 2])
        walker = TargetObstacle("walker", np.stack([pose, pose]), np.array([0.6, 0.5]))
        found = column_values(state, [walker], COLUMN_LOOKS)
        nearest = int(np.abs(DIRECTIONS - np.arctan2(aside, ahead - LOOKS_FROM)).argmin())
        assert found[nearest, 0] == 1.0 and found[:, 0].sum() <= 3
        away = np.hypot(ahead - LOOKS_FROM, aside)
        assert np.exp(found[nearest, 1]) == pytest.approx(away, abs=0.4)
        missed += not column_values(state, [walker], DIRECTIONS[:, None]).any()
    assert (missed > 0) == (ahead > 10)  # one look in a column's middle misses them


def test_the_mirrored_street_gives_mirrored_columns() -> None:
    state = make_state(np.zeros(3), 6.0)
    left = column_values(state, [moving(20, 2.0, 0.3, 4.0)], DIRECTIONS[:, None])
    right = column_values(state, [moving(20, -2.0, -0.3, 4.0)], DIRECTIONS[:, None])
    assert left[:, 0].any()
    np.testing.assert_allclose(mirror_columns(left), right, atol=1e-5)


def read(values: torch.Tensor) -> torch.Tensor:
    """What is read where it is read rightly."""
    found = values / torch.tensor(COLUMN_SCALES)
    found[..., 0] = 40.0 * (2.0 * values[..., 0] - 1.0)  # a sure logit
    return found


def test_right_readings_cost_nothing_and_unseen_motion_neither() -> None:
    state = make_state(np.zeros(3), 6.0)
    values = column_values(state, [moving(20, 1.0, 0.3, 4.0)], DIRECTIONS[:, None])
    columns = torch.from_numpy(values)[None]
    known, unknown = torch.tensor([True]), torch.tensor([False])
    assert float(column_loss(read(columns), columns, known)) < 1e-6
    slow = columns.clone()
    slow[..., 4] += 5.0
    assert float(column_loss(read(slow), columns, known)) > 0.1
    assert float(column_loss(read(slow), columns, unknown)) < 1e-6


def test_coarser_columns_tell_the_nearest_road_user() -> None:
    columns = torch.zeros(1, 4, len(COLUMN_VALUES))
    columns[0, 0] = torch.tensor([1.0, np.log(30.0), 1, 0, 0, 0])
    columns[0, 1] = torch.tensor([1.0, np.log(9.0), -1, 0, -3, 0])
    found = read(columns[:, [1, 3]])
    assert float(column_loss(found, columns, torch.tensor([True]))) < 1e-6
