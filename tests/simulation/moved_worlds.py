"""A small world with a surveyed map, and the same world moved or seen in a mirror."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recast.geometry import se2
from recast.logs.hdmap import HdMap, Lane
from recast.logs.types import DrivingLog, Track, Trajectory

Array = np.ndarray
Pose = tuple[float, float, float]

LANE = 3.4
_BEYOND = 80.0


def curved_world(speed: float = 9.3, seconds: float = 9.0, bend: float = 0.004) -> DrivingLog:
    """A drive through an S-bend at a speed that changes, on the right of two lanes."""
    times = np.arange(round(seconds * 10) + 1) * 0.1
    s = speed * times + 0.6 * np.sin(0.7 * times)
    fine = np.arange(-30.0, s[-1] + _BEYOND, 0.05)
    heading = bend * 40.0 * np.sin(fine / 40.0)
    xy = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) * 0.05
    path = np.concatenate([xy - xy[600], heading[:, None]], axis=1)
    poses = np.stack([np.interp(s, fine, path[:, k]) for k in range(3)], axis=1)
    trajectory = Trajectory((times * 1e6 + 5e6).astype(np.int64), se2.to_se3(poses))
    parked = np.repeat(se2.to_se3(np.array([[5.0, 40.0, 0.0]])), 2, axis=0)
    track = Track(
        "7", "car", np.array([4.3, 1.8, 1.5]), Trajectory(trajectory.timestamps_us[[0, -1]], parked)
    )
    lanes = {
        "right": _lane("right", path[::40], 0.0, left="left"),
        "left": _lane("left", path[::40], LANE, right="right"),
    }
    area = np.concatenate([_beside(path[::40], -2.6), _beside(path[::40], 5.3)[::-1]])
    return DrivingLog(
        name="s-bend",
        cameras={},
        lidars={},
        world_from_rig=trajectory,
        tracks={"7": track},
        map=HdMap(lanes, (area,)),
    )


def moved(log: DrivingLog, by: Pose) -> DrivingLog:
    """The world turned and shifted as a whole."""
    matrix = se2.to_se3(np.array(by))
    return _mapped(log, lambda poses: matrix @ poses, lambda xy: _points(by, xy))


def mirrored(log: DrivingLog) -> DrivingLog:
    """The world with left and right exchanged."""
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    other = _mapped(log, lambda poses: flip @ poses @ flip, lambda xy: xy * [1.0, -1.0])
    assert other.map is not None
    lanes = {
        key: replace(
            lane,
            left_boundary=lane.right_boundary,
            right_boundary=lane.left_boundary,
            left_neighbour=lane.right_neighbour,
            right_neighbour=lane.left_neighbour,
            polygon=lane.polygon[::-1],
        )
        for key, lane in other.map.lanes.items()
    }
    area = tuple(outline[::-1] for outline in other.map.drivable_area)
    return replace(other, map=replace(other.map, lanes=lanes, drivable_area=area))


def mirrored_states(states: Array) -> Array:
    """States (..., >=3) with y and heading reversed; an ego's (..., 11) with all that turns."""
    columns = [1, 2] if states.shape[-1] < 11 else [1, 2, 4, 6, 7, 8, 9, 10]
    other = states.copy()
    other[..., columns] *= -1
    return other


def _mapped(
    log: DrivingLog, poses: Callable[[Array], Array], points: Callable[[Array], Array]
) -> DrivingLog:
    def line(xyz: Array) -> Array:
        return np.concatenate([points(xyz[:, :2]), xyz[:, 2:]], axis=1)

    assert log.map is not None
    lanes = {
        key: replace(
            lane,
            centreline=line(lane.centreline),
            left_boundary=line(lane.left_boundary),
            right_boundary=line(lane.right_boundary),
            polygon=points(lane.polygon),
        )
        for key, lane in log.map.lanes.items()
    }

    def path(trajectory: Trajectory) -> Trajectory:
        return replace(trajectory, poses=poses(trajectory.poses))

    return replace(
        log,
        world_from_rig=path(log.world_from_rig),
        tracks={k: replace(t, trajectory=path(t.trajectory)) for k, t in log.tracks.items()},
        map=replace(
            log.map, lanes=lanes, drivable_area=tuple(points(a) for a in log.map.drivable_area)
        ),
    )


def _points(by: Pose, xy: Array) -> Array:
    poses = np.concatenate([xy, np.zeros((len(xy), 1))], axis=1)
    return se2.compose(by, poses)[:, :2]


def _beside(path: Array, lateral: float) -> Array:
    normal = np.stack([-np.sin(path[:, 2]), np.cos(path[:, 2])], axis=1)
    return path[:, :2] + lateral * normal


def _lane(
    name: str, path: Array, lateral: float, left: str | None = None, right: str | None = None
) -> Lane:
    def line(offset: float) -> Array:
        xy = _beside(path, lateral + offset)
        return np.concatenate([xy, np.zeros((len(xy), 1))], axis=1)

    left_side, right_side = line(LANE / 2), line(-LANE / 2)
    polygon = np.concatenate([right_side[:, :2], left_side[::-1, :2]])
    return Lane(
        name,
        line(0.0),
        left_side,
        right_side,
        polygon,
        speed_limit=13.0,
        left_neighbour=left,
        right_neighbour=right,
    )
