"""The KITTI importer against a made-up drive whose truth is known, and against a real one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recast.geometry import se3
from recast.logs import DrivingLog, all_track_points
from recast.logs.importers.kitti import load_kitti
from support import tiny_drive as tiny
from support import tiny_world

from .street import seconds, street_from_world


@pytest.fixture(scope="module")
def plain(tiny_drive: tiny.TinyDrive) -> DrivingLog:
    """Without pose refinement: what the files say, exactly."""
    return load_kitti(tiny_drive.root, tiny.DRIVE, tiny_drive.labels, refine=False, with_map=False)


def test_ego_poses_are_the_true_ones(plain: DrivingLog) -> None:
    times = plain.world_from_rig.timestamps_us
    truth = tiny.street_from_rig(seconds(plain, times))
    np.testing.assert_allclose(street_from_world() @ plain.world_from_rig.poses, truth, atol=2e-3)


def test_refined_poses_stay_true(tiny_log: DrivingLog) -> None:
    times = tiny_log.world_from_rig.timestamps_us
    poses = street_from_world() @ tiny_log.world_from_rig.poses
    truth = tiny.street_from_rig(seconds(tiny_log, times))
    assert np.abs(poses[:, :3, 3] - truth[:, :3, 3]).max() < 0.03
    assert np.abs(poses[:, :3, :3] - truth[:, :3, :3]).max() < 2e-3


def test_world_offset_leads_back_to_the_mercator_plane(plain: DrivingLog) -> None:
    assert plain.world_offset[2] == pytest.approx(tiny.ALTITUDE, abs=1e-6)
    scale = np.cos(np.radians(tiny.LATITUDE)) * tiny.EARTH_RADIUS
    assert plain.world_offset[0] == pytest.approx(scale * np.radians(tiny.LONGITUDE), abs=1.0)


def test_sensors_sit_where_the_calibration_says(plain: DrivingLog) -> None:
    camera = plain.cameras["image_02"]
    assert (camera.camera.fx, camera.camera.cx) == (tiny.FOCAL, tiny.CX + 0.5)
    assert (camera.camera.width, camera.camera.height) == (tiny.WIDTH, tiny.HEIGHT)
    camera_from_rectified = se3.from_rotation_translation(np.eye(3), tiny.BASELINE)
    expected = se3.inverse(camera_from_rectified @ tiny.RECTIFIED_FROM_RIG)
    np.testing.assert_allclose(camera.rig_from_camera, expected, atol=1e-5)
    mount = plain.lidars["velodyne"].rig_from_lidar
    np.testing.assert_allclose(mount, tiny.RIG_FROM_VELODYNE, atol=1e-6)


def test_frames_keep_their_times_and_missing_sweeps_are_normal(plain: DrivingLog) -> None:
    lidar, camera = plain.lidars["velodyne"], plain.cameras["image_02"]
    np.testing.assert_allclose(seconds(plain, lidar.timestamps_us), 0.2 * np.arange(12), atol=2e-6)
    # The images' stamps come late; they are taken at the scanner's trigger.
    np.testing.assert_allclose(seconds(plain, camera.timestamps_us), 0.1 * np.arange(24), atol=2e-6)


def test_motion_of_the_turn_is_undone(plain: DrivingLog) -> None:
    """Facade points, measured while the car moved up to 0.4 m, lie on the facades."""
    world = street_from_world()
    for index in (0, 5, 11):
        sweep = plain.lidars["velodyne"].sweeps[index]
        street = se3.apply(world @ plain.world_from_rig.at(sweep.timestamp_us), sweep.points)
        wall = street[street[:, 2] > 0.5]
        wall = wall[np.abs(np.abs(wall[:, 1]) - tiny_world.FACADE) < 1.0]
        assert len(wall) > 1000
        assert np.abs(np.abs(wall[:, 1]) - tiny_world.FACADE).max() < 0.05
        parked = np.abs(street - tiny_world.parked_centre()) < tiny_world.CAR_SIZE / 2 + 0.3
        rear = street[parked.all(axis=1) & (street[:, 2] > 0.3)]
        back = tiny_world.PARKED[0] - tiny_world.CAR_SIZE[0] / 2
        if index < 11:  # not yet passed
            assert rear[:, 0].min() == pytest.approx(back, abs=0.03)


def test_tracks_are_where_the_cars_are(plain: DrivingLog) -> None:
    assert {name: track.category for name, track in plain.tracks.items()} == {
        "0": "car",
        "1": "van",
    }
    for name, centre in (("0", tiny_world.car_centre), ("1", lambda _: tiny_world.parked_centre())):
        track = plain.tracks[name]
        np.testing.assert_array_equal(track.size, tiny_world.CAR_SIZE)
        for time, pose in zip(track.trajectory.timestamps_us, track.trajectory.poses, strict=True):
            truth = tiny.street_from_rig(0.0)
            truth[:3, 3] = centre(seconds(plain, time))
            np.testing.assert_allclose(street_from_world() @ pose, truth, atol=5e-3)


def test_a_labelled_frame_covers_its_image(plain: DrivingLog) -> None:
    first, last = plain.cameras["image_02"].timestamps_us[[0, -1]]
    assert plain.tracks["0"].trajectory.covers(first)
    assert plain.tracks["0"].trajectory.covers(last)


def test_points_on_moving_and_parked_cars_are_sharp(plain: DrivingLog) -> None:
    found = all_track_points(plain, plain.tracks)
    half = tiny_world.CAR_SIZE / 2
    for name, side in (("0", -1), ("1", 1)):  # seen from its right, from its left
        points = found[name].points
        on_rear = np.abs(points[:, 0] + half[0]) < 0.04
        on_side = np.abs(points[:, 1] - side * half[1]) < 0.04
        on_top = np.abs(points[:, 2] - half[2]) < 0.04
        assert np.mean(on_rear | on_side | on_top) > 0.99
        assert min(on_rear.sum(), on_side.sum()) > 50
    assert set(np.unique(found["0"].sweep)) == set(range(12))


def test_tracklets_and_tracking_labels_agree(
    tiny_drive: tiny.TinyDrive, plain: DrivingLog, tmp_path: Path
) -> None:
    path = tmp_path / "tracklet_labels.xml"
    tiny.write_tracklets(path)
    log = load_kitti(tiny_drive.root, tiny.DRIVE, path, refine=False, with_map=False)
    mine, theirs = log.tracks["0"].trajectory, plain.tracks["0"].trajectory
    times = mine.timestamps_us[1:-1]
    np.testing.assert_array_equal(times, theirs.timestamps_us[1 : 1 + len(times)])
    np.testing.assert_allclose(mine.at(times), theirs.at(times), atol=1e-3)


def test_without_labels_there_are_no_tracks(tiny_drive: tiny.TinyDrive) -> None:
    log = load_kitti(tiny_drive.root, tiny.DRIVE + "_sync", refine=False, with_map=False)
    assert log.tracks == {}


def test_the_map_is_derived_unless_it_is_not_wanted(tiny_drive: tiny.TinyDrive) -> None:
    log = load_kitti(tiny_drive.root, tiny.DRIVE, tiny_drive.labels, refine=False)
    assert log.map is not None and log.map.derived and log.origin is None


def test_a_real_drive(kitti_0013: Path) -> None:
    labels = kitti_0013 / "tracking_labels" / "0003.txt"
    log = load_kitti(kitti_0013, "2011_09_26_drive_0013", labels, refine=False, with_map=False)
    log.validate()
    assert (len(log.cameras["image_02"].images), len(log.lidars["velodyne"].sweeps)) == (80, 40)
    assert [track.category for track in log.tracks.values()] == ["car"] * 5 + ["van"]
    speed = np.diff(log.world_from_rig.poses[:, :2, 3], axis=0) / 0.1
    assert 9.0 < np.median(np.linalg.norm(speed, axis=1)) < 14.0
    sweep = log.lidars["velodyne"].sweeps[10]
    near = np.linalg.norm(sweep.points[:, :2], axis=1) < 6.0
    under = sweep.points[near & (np.abs(sweep.points[:, 1]) < 1.5), 2]
    assert np.median(under) == pytest.approx(0.0, abs=0.06)  # the rig frame stands on the road
