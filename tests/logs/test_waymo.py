"""The Waymo importer against a made-up segment whose truth is known."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from recast.geometry import boxes, se3
from recast.logs import DrivingLog, read_log
from recast.logs.importers.waymo import load_waymo
from recast.logs.importers.waymo_proto import lidar_name
from recast.logs.importers.waymo_segment import LaserCalibration, beams, range_image_points
from support import tiny_waymo as tiny
from support.importing import import_drive


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    folder = tmp_path_factory.mktemp("waymo")
    tiny.write_segment(folder / "training")
    import_drive("waymo", folder, tiny.NAME, folder / "log")
    return read_log(folder / "log")


def _street_from_world(log: DrivingLog) -> np.ndarray:
    global_from_world = se3.from_rotation_translation(np.eye(3), log.world_offset)
    return se3.inverse(tiny.GLOBAL_FROM_STREET) @ global_from_world


def _seconds(times_us: np.ndarray) -> np.ndarray:
    return (np.asarray(times_us) - tiny.START_US) / 1e6


def test_every_image_has_the_pose_of_its_own_time(log: DrivingLog) -> None:
    assert np.linalg.norm(log.world_from_rig.poses[0, :3, 3]) < 1.0
    for name, stream in log.cameras.items():
        assert len(stream.images) == 3
        for k, time in enumerate(stream.timestamps_us):
            seconds = tiny.image_seconds(name, k)
            assert abs(_seconds(time) - seconds) < 2e-6
            posed = _street_from_world(log) @ log.world_from_rig.at(time)
            np.testing.assert_allclose(posed, tiny.street_from_vehicle(seconds), atol=1e-6)


def test_images_keep_their_bytes_and_cameras_their_calibration(log: DrivingLog) -> None:
    assert set(log.cameras) == set(tiny.CAMERAS)
    for name, (_, azimuth) in tiny.CAMERAS.items():
        stream = log.cameras[name]
        assert stream.images.encoded(1) == (tiny.picture(1, name), "jpeg")  # type: ignore[attr-defined]
        assert stream.images[2].shape == (tiny.HEIGHT, tiny.WIDTH, 3)
        assert stream.camera.distortion == tiny.INTRINSIC[4:]
        # A point of the vehicle frame by the dataset's own formula.
        angle = math.radians(azimuth)
        ahead, left, up = 8.0, 1.0, 0.7
        point = se3.rotation_z(angle) @ [ahead, left, up] + [1.5, 0.0, 2.1]
        un, vn = -left / ahead, -up / ahead
        fu, fv, cu, cv, k1, k2, p1, p2, k3 = tiny.INTRINSIC
        r2 = un * un + vn * vn
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        und = un * radial + 2 * p1 * un * vn + p2 * (r2 + 2 * un * un)
        vnd = vn * radial + p1 * (r2 + 2 * vn * vn) + 2 * p2 * un * vn
        pixel, _ = stream.camera.project(se3.apply(se3.inverse(stream.rig_from_camera), [point]))
        np.testing.assert_allclose(pixel, [[fu * und + cu, fv * vnd + cv]], atol=1e-9)
    shutter = json.loads(log.metadata["rolling_shutter"])["FRONT"]
    assert shutter == {"direction": "left to right", "first_us": -24000, "last_us": 20000}


@pytest.mark.parametrize("name", ["TOP", "REAR"])
def test_points_lie_on_what_the_rays_hit(log: DrivingLog, name: str) -> None:
    stream = log.lidars[lidar_name(name)]
    for k, time in enumerate(stream.timestamps_us):
        assert abs(_seconds(time) - tiny.image_seconds("FRONT", k)) < 2e-6
        image, _ = tiny.range_images(k, name)
        sweep = stream.sweeps[k]
        first, second = int((image[..., 0] > 0).sum()), int((image[..., 0] > 30).sum())
        assert len(sweep.points) == first + second > first
        world_from_rig = log.world_from_rig.at(time)
        street = se3.apply(_street_from_world(log) @ world_from_rig, sweep.points)
        off = np.minimum(np.abs(street[:, 2]), np.abs(street[:, 0] - tiny.WALL))
        assert off.max() < 2e-3
        rows = np.repeat(np.arange(len(image)), (image[..., 0] > 0).sum(axis=1))
        np.testing.assert_allclose(sweep.intensity[:first], np.tanh(0.5 * (rows + 1)), atol=1e-6)
    # It was not for nothing: during the turn the ego drives a metre.
    assert name == "REAR" or np.ptp(stream.sweeps[0].point_timestamps_us) > 90_000


def test_the_points_of_a_range_image_are_those_of_single_rays() -> None:
    generator = np.random.default_rng(3)
    image = generator.uniform(-5.0, 60.0, (5, 12, 4)).astype(np.float32)
    poses = generator.uniform(-1.0, 1.0, (5, 12, 6)).astype(np.float32)
    mount = se3.from_rotation_translation(
        se3.exp(np.array([0, 0, 0, 0.05, -0.1, 2.0]))[:3, :3], [1.4, 0.1, 2.2]
    )
    inclinations = np.array([-0.4, -0.2, -0.1, 0.0, 0.05])
    got, rows, columns = range_image_points(
        image, LaserCalibration(inclinations, -0.4, 0.05, mount), poses
    )
    expected = []
    for i in range(5):
        for j in range(12):
            distance = float(image[i, j, 0])
            if distance <= 0:
                continue
            phi = inclinations[5 - 1 - i]
            alpha = ((12 - j - 0.5) / 12 * 2 - 1) * math.pi - math.atan2(mount[1, 0], mount[0, 0])
            x = distance * math.cos(alpha) * math.cos(phi)
            y = distance * math.sin(alpha) * math.cos(phi)
            z = distance * math.sin(phi)
            vehicle = [
                mount[k, 0] * x + mount[k, 1] * y + mount[k, 2] * z + mount[k, 3] for k in range(3)
            ]
            roll, pitch, yaw, *place = (float(value) for value in poses[i, j])
            c, s = math.cos, math.sin
            turn_x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
            turn_y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
            turn_z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
            expected.append(turn_z @ turn_y @ turn_x @ vehicle + place)
    np.testing.assert_allclose(got, expected, atol=1e-9)
    assert np.all(image[rows, columns, 0] > 0)


def test_evenly_spread_beams_and_columns_look_where_the_dataset_says() -> None:
    rows = beams(LaserCalibration(np.zeros(0), -1.5, 0.5, np.eye(4)), 4)
    np.testing.assert_allclose(rows, [0.25, -0.25, -0.75, -1.25])
    image = np.ones((4, 8, 4), np.float32)
    points, _, columns = range_image_points(
        image, LaserCalibration(np.zeros(0), -1.5, 0.5, np.eye(4)), None
    )
    first = points[columns == 0][0]
    assert first[0] < 0 < first[1]  # backwards, and turning over the left side
    assert points[columns == 1][0][1] > first[1]


def test_a_track_is_where_the_car_was_when_it_was_scanned(log: DrivingLog) -> None:
    car = log.tracks["car"]
    assert car.category == "car" and log.tracks["sign"].category == "misc"
    np.testing.assert_allclose(car.size, tiny.CAR_SIZE)
    for time, pose in zip(car.trajectory.timestamps_us, car.trajectory.poses, strict=True):
        truth = se3.inverse(tiny.GLOBAL_FROM_STREET) @ tiny.global_from_car(_seconds(time))
        np.testing.assert_allclose(_street_from_world(log) @ pose, truth, atol=1e-4)
    for stream in log.cameras.values():  # boxes cover every image
        for track in log.tracks.values():
            assert all(track.trajectory.covers(time) for time in stream.timestamps_us)


def test_the_map(log: DrivingLog) -> None:
    assert log.map is not None
    log.map.validate()
    lanes = log.map.lanes
    assert set(lanes) == {"1", "2", "3"}  # no bicycle lane, no lane of one point
    street_from_world = _street_from_world(log)
    centre = se3.apply(street_from_world, lanes["1"].centreline)
    np.testing.assert_allclose(centre[[0, -1]], [[-20, 0, 0], [30, 0, 0]], atol=1e-6)
    left = se3.apply(street_from_world, lanes["1"].left_boundary)[:, 1]
    right = se3.apply(street_from_world, lanes["1"].right_boundary)[:, 1]
    np.testing.assert_allclose(left, 1.6, atol=1e-6)
    np.testing.assert_allclose(right, [-1.8] * 6 + [-1.75] * 5, atol=1e-6)
    assert lanes["1"].successors == ("2",)
    assert (lanes["1"].left_neighbour, lanes["1"].right_neighbour) == ("3", None)
    assert lanes["3"].right_neighbour == "1"  # the longer of two
    assert lanes["1"].speed_limit == pytest.approx(25 * 0.44704)
    assert lanes["2"].speed_limit is None and lanes["2"].is_intersection
    for lane in lanes.values():
        assert shapely.Polygon(lane.polygon).exterior.is_ccw


@pytest.mark.parametrize(
    ("place", "inside"),
    [
        ((5.0, 0.0), True),  # lane
        ((5.0, -2.6), True),  # bicycle lane
        ((5.0, -5.5), True),  # between it and the kerb
        ((45.0, -5.5), True),  # beside a lane with no boundary
        ((22.0, -9.0), True),  # driveway
        ((5.0, -6.5), False),  # beyond the kerb
        ((5.0, 8.0), False),  # no kerb near: only the lane
        ((45.0, 3.0), False),
    ],
)
def test_one_can_drive_on_lanes_and_up_to_the_kerb(
    log: DrivingLog, place: tuple[float, float], inside: bool
) -> None:
    assert log.map is not None
    world = se3.apply(se3.inverse(_street_from_world(log)), [[*place, 0.0]])
    outlines = [shapely.Polygon(outline) for outline in log.map.drivable_area]
    assert any(o.contains(shapely.Point(world[0, :2])) for o in outlines) == inside


def test_the_ego_and_the_rest(log: DrivingLog, tmp_path: Path) -> None:
    assert log.metadata["location"] == "location_sf" and log.metadata["drive"] == tiny.NAME
    sign = boxes.corners(log.tracks["sign"].size)
    assert np.ptp(sign, axis=0).tolist() == [0.1, 0.6, 0.6]
    # The same input gives the same bytes, and a segment may be named by its file.
    tiny.write_segment(tmp_path)
    for name in ("a", "b"):
        import_drive("waymo", tmp_path, tiny.FILE, tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_segment_without_range_images_map_or_second_frame(tmp_path: Path) -> None:
    tiny.write_segment(tmp_path, tiny.Parts(frames=1, lasers=False, features=[]))
    log = load_waymo(tmp_path, tiny.NAME)
    log.validate()
    assert not log.lidars and log.map is None and len(log.tracks) == 2
    assert len(log.cameras["FRONT"].images) == 1


def test_a_turn_in_which_nothing_returned_has_no_points(tmp_path: Path) -> None:
    def nothing(frame: int, name: str, data: bytes) -> bytes:
        image, _ = tiny.range_images(frame, name)
        return tiny.matrix(np.full_like(image, -1.0)) if name == "REAR" else data

    tiny.write_segment(tmp_path, tiny.Parts(frames=1, range_image=nothing, second=False))
    import_drive("waymo", tmp_path, tiny.NAME, tmp_path / "log")
    log = read_log(tmp_path / "log")
    assert len(log.lidars["lidar_rear"].sweeps[0].points) == 0
    assert len(log.lidars["lidar_top"].sweeps[0].points) > 50
