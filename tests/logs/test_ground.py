"""Even ground: a road and its pavement, without the kerb between them and a parked car."""

from __future__ import annotations

import numpy as np

from recast.logs import even_ground

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


def test_no_points_no_ground() -> None:
    ground = even_ground([np.zeros((0, 3))], PATH)
    assert np.isnan(ground.height).all()
