from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.scene.light.relight import SceneLight
from recast.scene.light.sun import SUN_OVER_SKY, Occupancy, directions
from recast.splats import concatenate
from recast.splats.gaussians import harmonic_basis
from scene.light import made_up

HOUSE = np.array([8.0, 4.0, 6.0])


def houses_in_the_sun(azimuth: float, elevation: float) -> made_up.StreetScene:
    """Four houses beside a road, drawn as bright as a sun there makes them and the ground."""
    away = np.array([np.cos(azimuth), np.sin(azimuth)]) / np.tan(elevation)
    towards = np.array([*np.cos(elevation) * away * np.tan(elevation), np.sin(elevation)])
    ground = made_up.grid((-5, 45), (-12, 12), 0.5)
    corners = [np.array([x, y]) for x in (4.0, 26.0) for y in (-10.0, 6.0)]
    lit = np.ones(len(ground), bool)
    for corner in corners:
        for height in np.arange(0.0, HOUSE[2], 0.25):  # slices of the house, moved along the rays
            local = ground[:, :2] + height * away - corner
            lit &= ~np.all((local > 0) & (local < HOUSE[:2]), axis=1)

    def display(facing: np.ndarray | float, sky: float) -> np.ndarray:
        return np.asarray((0.1 * (sky + SUN_OVER_SKY * np.maximum(facing, 0))) ** (1 / 2.2))

    up = np.array([0.0, 0.0, 1.0])
    parts = [made_up.sheet(ground, up, display(lit * towards[2], 1.0))]
    for corner in corners:
        for axis in (0, 1):
            for side in (-1.0, 1.0):
                across = 1 - axis
                normal = np.zeros(3)
                normal[axis] = side
                wall = made_up.grid((0, HOUSE[across]), (0, HOUSE[2]))
                points = np.zeros_like(wall)
                points[:, across] = corner[across] + wall[:, 0]
                points[:, axis] = corner[axis] + (HOUSE[axis] if side > 0 else 0.0)
                points[:, 2] = wall[:, 1]
                seen = -side * (points[:, 1] - 0.0) > 0 if axis == 1 else np.full(len(wall), True)
                bright = np.full(len(wall), display(normal @ towards, 0.5))
                parts.append(made_up.sheet(points[seen], normal, bright[seen]))
    return made_up.street(concatenate(parts))


@pytest.mark.parametrize("azimuth", [40.0, 130.0, -70.0])
def test_the_sun_is_where_the_street_is_bright(azimuth: float) -> None:
    scene = houses_in_the_sun(np.radians(azimuth), np.radians(40.0))
    sun = SceneLight.of(scene).sun
    x, y, _ = sun.probability @ directions()[0]
    off = (np.degrees(np.arctan2(y, x)) - azimuth + 180) % 360 - 180
    assert abs(off) < 30  # two steps of the table
    assert sun.certainty > 0.5
    assert f"azimuth {np.degrees(np.arctan2(y, x)):.0f}" in sun.explain()


def test_a_street_that_tells_nothing() -> None:
    even = made_up.sheet(
        made_up.grid((-5, 45), (-4, 4)), np.array([0.0, 0.0, 1.0]), np.array([0.4])
    )
    sun = SceneLight.of(made_up.street(even)).sun
    assert sun.certainty == pytest.approx(0.0, abs=1e-9)
    assert "is unknown" in sun.explain()


def test_harmonics_are_those_of_the_clamped_cosine() -> None:
    """1/4 + c/2 + 5 (3 c^2 - 1) / 32, Ramamoorthi and Hanrahan's expansion up to degree 2."""
    sun = made_up.sun_at(0.0, np.radians(30.0))
    normals = torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=1)
    c = normals.numpy() @ (sun.probability @ directions()[0])
    found = harmonic_basis(normals, 2).numpy() @ sun.harmonics
    np.testing.assert_allclose(found, 0.25 + 0.5 * c + 5 * (3 * c**2 - 1) / 32, atol=1e-12)


def test_light_is_stopped_by_what_is_filled() -> None:
    wall = np.stack([np.full(400, 5.0), *np.random.default_rng(0).uniform(-3, 3, (2, 400))], -1)
    occupancy = Occupancy(wall, np.ones(400), np.zeros((1, 3)))
    points = np.array([[0.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
    ahead = occupancy.through(points, np.array([1.0, 0.0, 0.0]))
    assert ahead[0] < 0.1 and ahead[1] == 1.0  # before the wall, and behind it
    assert occupancy.through(points, np.array([0.0, 0.0, 1.0])).min() == 1.0


def test_a_huge_street_is_cut_to_a_bearable_grid() -> None:
    far = np.array([[1e5, 1e5, 20.0], [-1e5, -1e5, 0.0]])
    occupancy = Occupancy(far, np.ones(2), np.zeros((1, 3)))
    assert occupancy.through(np.zeros((1, 3)), np.array([0.0, 0.0, 1.0]))[0] == 1.0
