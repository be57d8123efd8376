"""The derived map against the made-up street, whose road, kerbs and lanes are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from recast.core.errors import InputError
from recast.geometry import boxes, se2, se3
from recast.logs import DrivingLog, HdMap, Trajectory, derive_map
from recast.logs.derive_map import ego_path
from recast.logs.importers.kitti import load_kitti
from support import tiny_drive as tiny
from support import tiny_world

from .street import street_from_world


def in_street(points: np.ndarray) -> np.ndarray:
    """World points (N, 2 or 3) in the street frame, (N, 3)."""
    flat = np.column_stack([points[:, :2], np.zeros(len(points))])
    moved = se3.apply(street_from_world(), flat)
    return np.column_stack([moved[:, :2], points[:, 2] if points.shape[1] == 3 else moved[:, 2]])


@pytest.fixture
def tiny_map(tiny_log: DrivingLog) -> HdMap:
    assert tiny_log.map is not None
    return tiny_log.map


def test_the_import_brings_a_derived_map(tiny_map: HdMap) -> None:
    assert tiny_map.derived
    assert set(tiny_map.notes) == {"lanes", "drivable_area", "ground"}


def test_the_ego_lane_is_the_recorded_path(tiny_log: DrivingLog, tiny_map: HdMap) -> None:
    line = in_street(tiny_map.lanes["ego"].centreline)
    np.testing.assert_allclose(line[:, 1], 0.0, atol=0.02)
    places = tiny_log.world_from_rig.poses[[0, -1], :3, 3]
    np.testing.assert_allclose(
        tiny_map.lanes["ego"].centreline[[0, -1], :2], places[:, :2], atol=1e-6
    )
    assert np.all(np.diff(line[:, 0]) < 1.01)


def test_lanes_lie_side_by_side_on_the_road(tiny_map: HdMap) -> None:
    left, ego, right = (tiny_map.lanes[name] for name in ("left", "ego", "right"))
    assert (ego.left_neighbour, ego.right_neighbour) == ("left", "right")
    assert (left.right_neighbour, right.left_neighbour) == ("ego", "ego")
    np.testing.assert_allclose(in_street(ego.left_boundary)[:, 1], 1.75, atol=0.05)
    np.testing.assert_array_equal(left.right_boundary[:, :2], ego.left_boundary[:, :2])
    # The moving car drives at 3.4 m: that is the middle of its lane.
    np.testing.assert_allclose(in_street(left.centreline)[:, 1], 3.4, atol=0.1)
    for lane in (left, right):
        assert np.abs(in_street(lane.polygon)[:, 1]).max() < tiny_world.ROAD_HALF_WIDTH + 0.1
    for lane in (left, ego, right):
        assert shapely.Polygon(lane.polygon).exterior.is_ccw


def test_the_drivable_area_ends_at_the_kerbs(tiny_map: HdMap) -> None:
    area = shapely.union_all([shapely.Polygon(outline) for outline in tiny_map.drivable_area])
    outline = in_street(np.array(area.exterior.coords))
    assert np.abs(outline[:, 1]).max() < tiny_world.ROAD_HALF_WIDTH + 0.6  # two cells
    beyond = shapely.Polygon(outline[:, :2]).difference(
        shapely.box(-50, -tiny_world.ROAD_HALF_WIDTH, 50, tiny_world.ROAD_HALF_WIDTH)
    )
    assert beyond.area < 0.01 * area.area
    across = np.array([[10.0, y] for y in (-4.5, -2.0, 0.0, 2.0, 4.5)])
    back = se3.apply(
        se3.inverse(street_from_world()), np.column_stack([across, np.zeros(len(across))])
    )
    assert shapely.contains_xy(area, back[:, :2]).all()


def assert_ego_inside(log: DrivingLog) -> None:
    assert log.map is not None
    area = shapely.union_all([shapely.Polygon(outline) for outline in log.map.drivable_area])
    poses = se2.from_se3(log.world_from_rig.poses)
    centres = se2.compose(poses, np.array([1.4, 0.0, 0.0]))
    for corners in boxes.bev_corners(centres, 4.5, 1.8):
        assert area.contains(shapely.Polygon(corners))


def test_the_ego_is_always_on_drivable_ground(tiny_log: DrivingLog) -> None:
    assert_ego_inside(tiny_log)


def test_ground_heights(tiny_map: HdMap) -> None:
    assert tiny_map.ground is not None
    street = np.array([[8.0, y, 0.0] for y in (-7.5, -4.0, 0.0, 3.0, 7.5)])
    world = se3.apply(se3.inverse(street_from_world()), street)
    heights = tiny_map.ground.at(world[:, :2])
    np.testing.assert_allclose(heights, [0.15, 0.0, 0.0, 0.0, 0.15], atol=0.03)
    assert np.isnan(tiny_map.ground.at(np.array([1e4, 0.0])))


def test_no_lane_where_traffic_comes_towards_us(tiny_log: DrivingLog) -> None:
    track = tiny_log.tracks["0"]
    times, poses = track.trajectory.timestamps_us, track.trajectory.poses
    oncoming = replace(track, trajectory=Trajectory(times, poses[::-1]))
    lanes = derive_map(replace(tiny_log, tracks={"0": oncoming})).lanes
    assert set(lanes) == {"ego", "right"}
    assert lanes["ego"].left_neighbour is None


def test_a_standing_ego_has_no_path(tiny_log: DrivingLog) -> None:
    ego = tiny_log.world_from_rig
    still = Trajectory(ego.timestamps_us, np.broadcast_to(ego.poses[0], ego.poses.shape))
    assert ego_path(still) is None
    with pytest.raises(InputError, match="less than 2 m"):
        derive_map(replace(tiny_log, world_from_rig=still))


def test_a_real_road(kitti_0013: Path) -> None:
    """On 2011_09_26_0013 the ego stays between two kerbs, with room for a lane on its right."""
    labels = kitti_0013 / "tracking_labels" / "0003.txt"
    log = load_kitti(
        kitti_0013, tiny.DRIVE.replace("9999", "0013"), labels, refine=False, with_map=False
    )
    lidar = log.lidars["velodyne"]
    few = replace(lidar, timestamps_us=lidar.timestamps_us[:10])
    hd_map = derive_map(replace(log, lidars={"velodyne": few}))
    hd_map.validate()
    assert_ego_inside(replace(log, map=hd_map))
    assert "right" in hd_map.lanes
