"""What the columns of a picture show, and how it is read from their tokens."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import torch

from recast.dynamics import make_state
from recast.geometry import boxes, se2
from recast.planning.gtrs.expert import TargetObstacle
from recast_tools.planner_data.dataset import column_directions
from recast_tools.planner_training.samples import COLUMNS, mirror_columns
from recast_tools.planner_training.targets import COLUMN_VALUES, column_values
from recast_tools.planner_training.task import HALF_VIEWS, ClueReader
from support.target_roads import moving

DIRECTIONS = column_directions(HALF_VIEWS, COLUMNS)


def test_columns_look_from_left_to_right() -> None:
    assert DIRECTIONS.shape == (COLUMNS,)
    assert np.all(np.diff(DIRECTIONS) < 0)
    np.testing.assert_allclose(DIRECTIONS, -DIRECTIONS[::-1], atol=1e-6)
    assert np.deg2rad(55) < DIRECTIONS[0] < np.deg2rad(65)


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
    found = column_values(state, cars, DIRECTIONS)
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


def test_the_mirrored_street_gives_mirrored_columns() -> None:
    state = make_state(np.zeros(3), 6.0)
    left = column_values(state, [moving(20, 2.0, 0.3, 4.0)], DIRECTIONS)
    right = column_values(state, [moving(20, -2.0, -0.3, 4.0)], DIRECTIONS)
    assert left[:, 0].any()
    np.testing.assert_allclose(mirror_columns(left), right, atol=1e-5)


def told(reader: ClueReader, value: torch.Tensor) -> torch.Tensor:
    """Tokens from which a reader with an identity reads values."""
    with torch.no_grad():
        reader.column.weight.copy_(torch.eye(len(COLUMN_VALUES)))
        reader.column.bias.zero_()
    tokens = value / reader.column_scales
    tokens[..., 0] = 40.0 * (2.0 * value[..., 0] - 1.0)  # a sure logit
    return tokens


@torch.no_grad()
def test_right_readings_cost_nothing_and_unseen_motion_neither() -> None:
    reader = ClueReader(len(COLUMN_VALUES), torch.Generator().manual_seed(0))
    state = make_state(np.zeros(3), 6.0)
    values = column_values(state, [moving(20, 1.0, 0.3, 4.0)], DIRECTIONS)
    columns = torch.from_numpy(values)[None]
    known, unknown = torch.tensor([True]), torch.tensor([False])
    right = told(reader, columns.clone())
    assert float(reader.column_loss(right, columns, known)) < 1e-6
    slow = columns.clone()
    slow[..., 4] += 5.0
    wrong = told(reader, slow)
    assert float(reader.column_loss(wrong, columns, known)) > 0.1
    assert float(reader.column_loss(wrong, columns, unknown)) < 1e-6


@torch.no_grad()
def test_coarser_columns_tell_the_nearest_vehicle() -> None:
    reader = ClueReader(len(COLUMN_VALUES), torch.Generator().manual_seed(0))
    columns = torch.zeros(1, 4, len(COLUMN_VALUES))
    columns[0, 0] = torch.tensor([1.0, np.log(30.0), 1, 0, 0, 0])
    columns[0, 1] = torch.tensor([1.0, np.log(9.0), -1, 0, -3, 0])
    wanted = columns[:, [1, 3]]
    seen = told(reader, wanted.clone())
    assert float(reader.column_loss(seen, columns, torch.tensor([True]))) < 1e-6
