"""Even ground: a road and its pavement, without the kerb between them and a parked car."""

from __future__ import annotations

import numpy as np

from recast.logs import even_ground
from recast.logs.derive_map import CELL, LOW, MIN_POINTS, REACH, ground_grid, ground_points

PATH = np.stack([np.linspace(0, 30, 31), np.zeros(31), 0.02 * np.linspace(0, 30, 31)], axis=-1)


def sweep(rng: np.random.Generator) -> np.ndarray:
    """Points (12000, 3) of a road of 2 %, a pavement 12 cm higher from y = 4 m on, and a car."""
    xy = rng.uniform([0, -8], [30, 8], (12_000, 2))
    z = 0.02 * xy[:, 0] + 0.12 * (xy[:, 1] > 4)
    car = (np.abs(xy[:, 0] - 20) < 2) & (np.abs(xy[:, 1] + 4) < 0.9)
    z[car] += rng.uniform(0.0, 0.4, car.sum())
    return np.column_stack([xy, z + rng.normal(0, 0.01, len(xy))])


def test_heights_are_those_of_road_and_pavement() -> None:
    ground = even_ground((sweep(np.random.default_rng(i)) for i in range(10)), PATH)
    x, y = np.meshgrid(np.arange(3.0, 28.0), [-7.0, -2.0, 0.0, 2.0, 6.0])
    found = ground.at(np.stack([x, y], axis=-1))
    far = np.hypot(x - 20, y + 4) > 4
    truth = 0.02 * x + 0.12 * (y > 4)
    assert np.isfinite(found[far]).mean() > 0.98
    # a cell of 0.3 m is up to 0.15 m away, which is 3 mm of a slope of 2 %
    assert np.nanmax(np.abs(found - truth)[far]) < 0.01


def test_a_kerb_and_what_stands_on_the_road_are_no_even_ground() -> None:
    ground = even_ground((sweep(np.random.default_rng(i)) for i in range(10)), PATH)
    kerb = np.stack([np.arange(3.0, 28.0), np.full(25, 4.0)], axis=-1)
    assert np.isnan(ground.at(kerb)).all()
    car = np.stack(np.meshgrid([19.0, 20.0, 21.0], [-4.3, -4.0, -3.7]), axis=-1)
    assert np.isnan(ground.at(car)).all()


def test_ground_is_gathered_and_counted_as_one_would_by_hand() -> None:
    rng = np.random.default_rng(4)
    clouds = [rng.uniform([-12, 7, -2], [3, 17, 2], (6_000, 3)) for _ in range(2)]
    kept = [
        point
        for point in np.concatenate(clouds)
        for gaps in [np.hypot(*(point[:2] - PATH[:, :2]).T)]
        if gaps.min() < REACH and abs(point[2] - PATH[gaps.argmin(), 2]) < 0.4 + 0.04 * gaps.min()
    ]
    found = ground_points(clouds, PATH)
    np.testing.assert_array_equal(found, kept)
    grid = ground_grid(found, PATH)
    cells: dict[tuple[int, int], list[float]] = {}
    for point in found:
        column, row = np.rint((point[:2] - grid.origin) / CELL).astype(int)
        cells.setdefault((row, column), []).append(point[2])
    level = np.full_like(grid.level, np.nan)
    for cell, heights in cells.items():
        if len(heights) >= MIN_POINTS:
            level[cell] = sorted(heights)[int(LOW * (len(heights) - 1))]
    assert np.isfinite(level).any()
    np.testing.assert_array_equal(grid.level, level)


def test_no_points_no_ground() -> None:
    ground = even_ground([np.zeros((0, 3))], PATH)
    assert np.isnan(ground.height).all()
