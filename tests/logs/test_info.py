"""What `recast log info` knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recast.logs import DrivingLog, Track, TrackInfo, Trajectory, log_info
from recast.logs.load import ranked, track_visibility
from support import tiny_drive as tiny
from support import tiny_world


def test_log_info_of_the_tiny_drive(tiny_log: DrivingLog) -> None:
    info = log_info(tiny_log)
    assert (info.name, info.map_kind, info.lanes) == (tiny.DRIVE, "derived", 3)
    assert info.ego_distance == pytest.approx(tiny.EGO_SPEED * info.seconds, rel=0.01)
    camera, lidar = info.sensors
    assert (camera.kind, camera.frames, camera.width, camera.height) == ("camera", 24, 160, 48)
    assert camera.rate == pytest.approx(10.0, abs=0.01)
    assert (lidar.kind, lidar.frames, lidar.width) == ("lidar", 12, None)
    moving, parked = info.tracks
    assert (moving.track_id, moving.category) == ("0", "car")
    assert moving.displacement == pytest.approx(tiny_world.CAR_SPEED * moving.seconds, rel=0.01)
    assert parked.displacement < 0.1
    assert moving.lidar_points > 1000
    assert moving.size == tuple(tiny_world.CAR_SIZE)
    assert moving.visibility.sides() == ("rear", "right")
    assert parked.visibility.sides() == ("left", "rear")
    assert moving.visibility.frames == 24
    assert 15 < parked.visibility.frames < 24  # passed at the end


def test_a_track_behind_the_camera_is_never_visible(tiny_log: DrivingLog) -> None:
    track = tiny_log.tracks["0"]
    ego = tiny_log.world_from_rig
    behind = ego.poses.copy()
    behind[:, :3, 3] -= 12.0 * ego.poses[:, :3, 0]
    visibility = track_visibility(
        tiny_log, replace(track, trajectory=Trajectory(ego.timestamps_us, behind))
    )
    assert (visibility.frames, visibility.sides()) == (0, ())


@pytest.mark.parametrize(("angle", "side"), [(0, "rear"), (90, "left"), (180, "front")])
def test_sides_follow_the_heading(tiny_log: DrivingLog, angle: int, side: str) -> None:
    """A car 12 m straight ahead, turned on the spot, shows one face."""
    ego = tiny_log.world_from_rig
    turned = ego.poses.copy()
    turned[:, :3, 3] += 12.0 * ego.poses[:, :3, 0]
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned[:, :3, :3] = turned[:, :3, :3] @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
    track = replace(tiny_log.tracks["0"], trajectory=Trajectory(ego.timestamps_us, turned))
    assert track_visibility(tiny_log, track).sides() == (side,)


def _beside(log: DrivingLog, ahead: np.ndarray, beside: float) -> Track:
    """Track 0 at metres `ahead` (T,) and `beside` the ego."""
    ego = log.world_from_rig
    placed = ego.poses.copy()
    x, y, z = np.moveaxis(ego.poses[:, :3, :3], -1, 0)
    placed[:, :3, 3] += ahead[:, None] * x + beside * y + 0.8 * z
    return replace(log.tracks["0"], trajectory=Trajectory(ego.timestamps_us, placed))


@pytest.mark.parametrize(("beside", "usable"), [(4.0, True), (5.5, False)])
def test_a_car_that_the_border_cuts_in_every_image_is_not_recommended(
    tiny_log: DrivingLog, beside: float, usable: bool
) -> None:
    track = _beside(tiny_log, np.full(len(tiny_log.world_from_rig.poses), 10.0), beside)
    visibility = track_visibility(tiny_log, track)
    assert visibility.frames == 24 and visibility.whole == usable
    info = TrackInfo("0", "car", (4.0, 1.8, 1.5), 1.0, 0.0, 1000, visibility)
    (rated,) = ranked([info])
    assert rated.usable == usable
    assert usable or rated.why == "is cut by the image border in every image"


def test_the_largest_whole_crop_counts_not_a_larger_one_that_is_cut(tiny_log: DrivingLog) -> None:
    count = len(tiny_log.world_from_rig.poses)
    passed = track_visibility(tiny_log, _beside(tiny_log, np.linspace(20.0, 10.0, count), 5.0))
    alongside = track_visibility(tiny_log, _beside(tiny_log, np.full(count, 10.0), 5.0))
    assert passed.whole and not alongside.whole
    assert passed.crop[1] < alongside.crop[1]
