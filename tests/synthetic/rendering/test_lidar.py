"""The LiDAR: noise as stated, points on their rays, returns that depend on what is hit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.geometry import se3
from recast.synthetic.rendering import WAYMO_TOP, LidarSpec, RayScene, scan_lidar
from synthetic.rendering.shapes import box, nothing, plane, pose

LIDAR = se3.from_rotation_translation(se3.rotation_z(0.3), [1.0, 2.0, 2.2])


@pytest.fixture(scope="module")
def street() -> RayScene:
    return RayScene(plane(material="concrete"), {"car": box(), "mirror": box(material="glass")})


def scan(scene: RayScene, poses: dict | None = None, spec: LidarSpec = WAYMO_TOP, seed: int = 0):
    return scan_lidar(scene, spec, LIDAR, poses or {}, np.random.default_rng(seed))


def test_waymo_like_sensor() -> None:
    degrees = np.rad2deg(WAYMO_TOP.elevations)
    assert len(degrees) == 64 and degrees[0] == pytest.approx(2.4)
    assert degrees[-1] == pytest.approx(-17.6)
    assert np.all(np.diff(degrees) < 0) and -np.diff(degrees)[0] < -np.diff(degrees)[-1]
    assert len(WAYMO_TOP.directions()) == 64 * 937


def test_points_lie_on_their_rays_with_the_stated_noise(street: RayScene) -> None:
    found = scan(street, {"car": pose(8, 4)})
    directions = WAYMO_TOP.directions()[found.ray]
    assert np.allclose(found.points, directions * found.ranges[:, None], atol=1e-5)
    residual = found.ranges - found.true_ranges
    count = len(residual)
    assert count > 30_000
    assert abs(residual.mean()) < 4 * 0.02 / np.sqrt(count)
    assert residual.std() == pytest.approx(0.02, rel=0.03)


def test_true_ranges_are_of_the_surfaces(street: RayScene) -> None:
    found = scan(street)
    directions = WAYMO_TOP.directions()[found.ray].astype(float)
    assert np.allclose(found.true_ranges, -2.2 / directions[:, 2], rtol=1e-4)
    assert np.all(found.true_ranges <= 75) and np.all(found.true_ranges >= 0.8)


def test_points_of_a_vehicle_lie_in_its_box(street: RayScene) -> None:
    world_from_car = pose(8, 4, yaw=0.7)
    found = scan(street, {"car": world_from_car}, replace(WAYMO_TOP, range_noise=0.0))
    local = se3.apply(se3.inverse(world_from_car) @ LIDAR, found.points)
    inside = np.all(np.abs(local) < np.array([2.0, 0.9, 0.75]) + 1e-3, axis=1)
    on_ground = local[:, 2] < -0.74
    assert (found.instance == 1).sum() > 300
    assert np.all(inside[found.instance == 1])
    assert not np.any(inside[(found.instance != 1) & ~on_ground])


def test_glass_lets_most_pulses_through_and_paintwork_does_not(street: RayScene) -> None:
    matte = np.sum(scan(street, {"car": pose(25, 2)}).instance == 1)
    glass = np.sum(scan(street, {"mirror": pose(25, 2)}).instance == 2)
    assert matte > 50
    assert glass < 0.7 * matte


def test_far_and_grazing_returns_drop_out(street: RayScene) -> None:
    found = scan(RayScene(plane((0.05, 0.05, 0.05)), {}))
    total = -2.2 / np.minimum(WAYMO_TOP.directions()[:, 2], -1e-9)
    near, far = (total > 5) & (total < 10), (total > 60) & (total < 75)
    kept = np.zeros(len(total), bool)
    kept[found.ray] = True
    assert kept[near].mean() > 0.98
    assert kept[far].mean() < 0.7


def test_signs_shine(street: RayScene) -> None:
    scene = RayScene(
        plane(), {"plain": box((0.1, 3, 3)), "sign": box((0.1, 3, 3), material="sign")}
    )
    found = scan(scene, {"plain": pose(15, -3, 2), "sign": pose(15, 8, 2)})
    assert found.intensity[found.instance == 2].min() > 0.9
    assert found.intensity[found.instance == 1].max() < 0.7
    assert found.intensity.min() >= 0 and found.intensity.max() <= 1


def test_same_seed_same_bytes(street: RayScene) -> None:
    first, again, other = scan(street), scan(street), scan(street, seed=1)
    assert first.points.tobytes() == again.points.tobytes()
    assert first.intensity.tobytes() == again.intensity.tobytes()
    assert first.points.tobytes() != other.points.tobytes()


def test_nothing_to_hit() -> None:
    found = scan(RayScene(nothing(), {}))
    assert found.points.shape == (0, 3) and found.intensity.shape == (0,)


@pytest.mark.parametrize(
    "changes",
    [
        {"elevations": np.zeros(0)},
        {"elevations": np.array([2.0])},
        {"azimuths": 0},
        {"maximum_range": 0.5},
        {"range_noise": -0.1},
    ],
)
def test_sensors_that_cannot_be_are_refused(street: RayScene, changes: dict) -> None:
    with pytest.raises(ValueError, match="LidarSpec"):
        scan(street, spec=replace(WAYMO_TOP, **changes))
