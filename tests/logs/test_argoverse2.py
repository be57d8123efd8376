"""The Argoverse 2 importer against a made-up log whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.geometry import boxes, se3
from recast.logs import DrivingLog, Trajectory, read_log, track_points
from recast.logs.importers import IMPORTERS
from recast.logs.importers.argoverse2 import RIG_FROM_EGO, read_tracks
from support import tiny_argoverse2 as tiny
from support.importing import import_drive
from support.street_frame import street_from_world


@pytest.fixture(scope="module")
def tiny_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("argoverse2")
    tiny.write_tiny_log(root)
    return root


@pytest.fixture(scope="module")
def log(tiny_root: Path, tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    out = tmp_path_factory.mktemp("out") / "log"
    import_drive("argoverse2", tiny_root, tiny.LOG, out)
    return read_log(out)


def _seconds(times_us: np.ndarray) -> np.ndarray:
    return (times_us - tiny.START_NS // 1000) / 1e6


def test_the_rig_rolls_on_the_ground_near_the_origin(log: DrivingLog) -> None:
    times = _seconds(log.world_from_rig.timestamps_us)
    truth = tiny.street_from_ego(times)
    truth[:, 2, 3] = 0.0
    street = street_from_world(log, tiny.CITY_FROM_STREET) @ log.world_from_rig.poses
    np.testing.assert_allclose(street, truth, atol=1e-5)
    np.testing.assert_allclose(log.world_from_rig.poses[0, :3, 3], 0.0, atol=1e-9)


def test_boxes_are_placed_with_the_ego_of_their_sweep(log: DrivingLog) -> None:
    assert {key: track.category for key, track in log.tracks.items()} == {
        "car": "car",
        "bike": "cyclist",
    }
    car = log.tracks["car"]
    np.testing.assert_array_equal(car.size, tiny.CAR_SIZE)
    for time, pose in zip(car.trajectory.timestamps_us, car.trajectory.poses, strict=True):
        # Boxes hold in the middle of their turn; the last one is continued to its end.
        truth = tiny.street_from_car(float(_seconds(time)))
        np.testing.assert_allclose(
            street_from_world(log, tiny.CITY_FROM_STREET) @ pose, truth, atol=1e-5
        )


def test_a_fast_car_is_sharp_in_its_own_frame(log: DrivingLog) -> None:
    car = log.tracks["car"]
    points = track_points(log, car, margin=0.0, clearance=0.0)
    for number, sweep in enumerate((3, 4)):
        found = [points.points[points.sweep == number + first] for first in (0, 2)]
        truth = tiny.car_points(sweep * tiny.SWEEP_NS)
        # Each scanner met it half a metre from where the other did.
        for own, part in zip((truth[::2], truth[1::2]), found, strict=True):
            np.testing.assert_allclose(part, own, atol=0.02)


def test_a_labelled_sweep_counts_as_its_whole_turn(log: DrivingLog, tiny_root: Path) -> None:
    times = _seconds(log.tracks["car"].trajectory.timestamps_us)
    assert times[[0, 1, 2, -2, -1]] == pytest.approx([0.0, 0.054, 0.154, 2.054, 2.12])
    # Where the ego trajectory ends before, so do the boxes.
    ego = log.world_from_rig
    kept = _seconds(ego.timestamps_us) < 2.001
    short = Trajectory(ego.timestamps_us[kept], ego.poses[kept])
    path = tiny_root / "val" / tiny.LOG / "annotations.feather"
    cut = read_tracks(path, short, RIG_FROM_EGO)["car"].trajectory.timestamps_us
    assert _seconds(cut)[[0, 1, -2, -1]] == pytest.approx([0.0, 0.054, 1.954, 2.0])


def test_both_lidars_see_the_car_with_a_time_for_every_point(log: DrivingLog) -> None:
    up, down = log.lidars["up_lidar"], log.lidars["down_lidar"]
    for index in range(2):
        sweeps = [up.sweeps[index], down.sweeps[index]]
        time = sweeps[0].timestamp_us
        assert _seconds(time) == pytest.approx(0.3 + 0.1 * index)
        rig_from_world = se3.inverse(log.world_from_rig.at(time))
        for sweep, name in zip(sweeps, ("up_lidar", "down_lidar"), strict=True):
            seen = time + tiny.SEEN_NS[name] // 1000
            pose = rig_from_world @ log.tracks["car"].trajectory.at(seen)
            inside = boxes.contains(sweep.points, tiny.CAR_SIZE, pose)
            assert inside.sum() >= tiny.CAR_POINTS / 2 - 1
        road = np.concatenate([s.points[np.abs(s.points[:, 1] + 4.5) < 1.6] for s in sweeps])
        assert np.abs(road[:, 2]).max() < 2e-3
        times = np.sort(np.concatenate([sweep.point_timestamps_us for sweep in sweeps]))
        assert times[[0, -1]] - time == pytest.approx([2654, 106_000], abs=1)
        assert sweeps[0].intensity[1] == pytest.approx(2 / 255)
    lifted = se3.from_rotation_translation(np.eye(3), [0, 0, tiny.AXLE_HEIGHT])
    np.testing.assert_allclose(down.rig_from_lidar, lifted @ tiny.DOWN, atol=1e-6)
    np.testing.assert_allclose(up.rig_from_lidar, lifted @ tiny.UP, atol=1e-6)


def test_cameras_keep_their_own_times_and_bytes(log: DrivingLog, tiny_root: Path) -> None:
    ring, stereo = log.cameras["ring_front_center"], log.cameras["stereo_front_left"]
    np.testing.assert_allclose(_seconds(ring.timestamps_us), 0.05 * np.arange(9), atol=2e-6)
    files = sorted((tiny_root / "val" / tiny.LOG / "sensors/cameras").glob("*/*.jpg"))
    assert ring.images.encoded(3) == (files[3].read_bytes(), "jpeg")  # type: ignore[attr-defined]
    assert ring.images[3].shape == (tiny.HEIGHT, tiny.WIDTH, 3)
    # Images are undistorted; pixel centres are counted from 0 in the files.
    assert (ring.camera.fx, ring.camera.cx, ring.camera.cy) == (30.0, 12.0, 16.0)
    assert ring.camera.is_rectified
    # Calibrated, but without images here.
    assert len(stereo.images) == 0 and stereo.camera.fx == 31.0
    ahead = se3.apply(ring.rig_from_camera, np.array([[0.0, 0.0, 5.0]]))
    np.testing.assert_allclose(ahead, [[6.6, 0.0, 1.4 + tiny.AXLE_HEIGHT]], atol=1e-6)


def test_cameras_are_asynchronous_and_the_front_one_stands_upright(log: DrivingLog) -> None:
    front, side = log.cameras["ring_front_center"], log.cameras["ring_side_left"]
    assert (front.camera.width, front.camera.height) == (24, 32)
    assert (side.camera.width, side.camera.height) == (32, 24)
    assert side.images[2].shape == (24, 32, 3)
    np.testing.assert_allclose(_seconds(side.timestamps_us), 0.023 + 0.05 * np.arange(9), atol=2e-6)
    # Of its own time are ego and boxes at an image, whatever sweep is near.
    for stream in (front, side):
        time = int(stream.timestamps_us[5])
        assert time not in log.lidars["up_lidar"].timestamps_us
        placed = street_from_world(log, tiny.CITY_FROM_STREET)
        ego = placed @ log.world_from_rig.at(time)
        assert ego[0, 3] == pytest.approx(tiny.SPEED * _seconds(np.array(time)), abs=1e-4)
        car = placed @ log.tracks["car"].trajectory.at(time)
        truth = tiny.street_from_car(float(_seconds(np.array(time))))
        np.testing.assert_allclose(car, truth, atol=1e-4)


def test_lanes_have_averaged_centrelines_and_neighbours_of_one_way(log: DrivingLog) -> None:
    assert log.map is not None
    lanes = log.map.lanes
    assert sorted(lanes) == ["1", "2", "3", "4"]  # no bicycle lane
    street = se3.apply(street_from_world(log, tiny.CITY_FROM_STREET), lanes["1"].centreline)
    np.testing.assert_allclose(street[[0, -1]], [[-10, 0, 0], [30, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(street[:, 1:], 0.0, atol=1e-6)
    assert lanes["1"].successors == ("2",) and lanes["3"].successors == ()
    assert (lanes["1"].left_neighbour, lanes["1"].right_neighbour) == (None, "3")
    assert (lanes["3"].left_neighbour, lanes["3"].right_neighbour) == ("1", None)
    assert lanes["4"].left_neighbour is None
    assert lanes["2"].is_intersection and not lanes["1"].is_intersection
    for lane in lanes.values():
        x, y = lane.polygon.T
        assert x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0
    assert len(log.map.drivable_area) == 1
    assert not log.map.derived and log.map.notes["city"] == "PIT"


def test_ground_is_the_raster_under_its_cells(log: DrivingLog) -> None:
    assert log.map is not None and log.map.ground is not None
    # Row 40, column 50 of a raster whose corner is (980, 1980).
    place = np.array([980 + 50.5 * tiny.CELL, 1980 + 40.5 * tiny.CELL]) - log.world_offset[:2]
    expected = float(np.float16(60 + 0.5 + 0.8)) - log.world_offset[2]
    for edge in (-0.24, 0.24):
        assert log.map.ground.at(place + edge) == pytest.approx(expected, abs=1e-3)
    assert np.isnan(log.map.ground.at(np.array([980.1, 1980.1]) - log.world_offset[:2]))


def test_boxes_may_lie_apart_and_may_be_missing(tiny_root: Path, tmp_path: Path) -> None:
    load = IMPORTERS.load("recast.logs.importers.argoverse2:load_argoverse2")
    folder = tiny.write_tiny_log(tmp_path)
    own = folder / "annotations.feather"
    moved = own.rename(tmp_path / "other.feather")
    assert load(tmp_path, tiny.LOG).tracks == {}
    assert set(load(tmp_path, tiny.LOG, moved).tracks) == {"car", "bike"}
    moved.rename(folder / "annotations_with_ego.feather")
    assert set(load(folder, tiny.LOG).tracks) == {"car", "bike"}  # named by its own folder
