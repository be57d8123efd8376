"""No log with an impossible value is written: what is wrong is told in one line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.core.errors import InputError
from recast.logs import DrivingLog, HdMap, LidarSweep, Track, Trajectory, write_log
from recast.logs.hdmap import GroundHeight
from support.small_log import small_log

Change = Callable[[DrivingLog], DrivingLog]


def _ego(**change: object) -> Change:
    return lambda log: replace(log, world_from_rig=replace(log.world_from_rig, **change))


def _pose(row: int, column: int, value: float) -> Change:
    def change(log: DrivingLog) -> DrivingLog:
        poses = log.world_from_rig.poses.copy()
        poses[2, row, column] = value
        return replace(log, world_from_rig=replace(log.world_from_rig, poses=poses))

    return change


def _camera(**change: object) -> Change:
    return lambda log: replace(log, cameras={"front": replace(log.cameras["front"], **change)})


def _intrinsics(**change: object) -> Change:
    return lambda log: _camera(camera=replace(log.cameras["front"].camera, **change))(log)


def _lidar(**change: object) -> Change:
    return lambda log: replace(log, lidars={"top": replace(log.lidars["top"], **change)})


def _track(**change: object) -> Change:
    return lambda log: replace(log, tracks={"car 7": replace(log.tracks["car 7"], **change)})


def _late(log: DrivingLog) -> DrivingLog:
    track = log.tracks["car 7"].trajectory
    later = replace(track, timestamps_us=track.timestamps_us + 3_600_000_000)
    return _track(trajectory=later)(log)


def _mirrored(log: DrivingLog) -> DrivingLog:
    poses = log.world_from_rig.poses @ np.diag([1.0, -1.0, 1.0, 1.0])
    return _ego(poses=poses)(log)


TIMES = np.arange(6, dtype=np.int64) * 100_000
NO_POSES = Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
CASES: dict[str, tuple[Change, str]] = {
    "name": (lambda log: replace(log, name="\ud800"), "lone surrogate"),
    "metadata": (lambda log: replace(log, metadata={"a": "\udfff"}), "metadata['a']"),
    "metadata of numbers": (lambda log: replace(log, metadata={"a": 1}), "expected text"),
    "offset": (lambda log: replace(log, world_offset=np.array([0, np.nan, 0])), "world_offset"),
    "ego not finite": (_pose(1, 3, np.inf), "world_from_rig.poses: inf is not within"),
    "ego beyond the Earth": (_pose(1, 3, 1e9), "world_from_rig.poses: 1e+09 is not within"),
    "ego not rigid": (_pose(0, 0, 0.5), "is not a rotation"),
    "ego rotation NaN": (_pose(0, 0, np.nan), "nan is not within"),
    "ego mirrored": (_mirrored, "mirror image"),
    "ego sheared": (_pose(3, 0, 0.1), "last row"),
    "ego not sorted": (_ego(timestamps_us=TIMES[::-1].copy()), "must increase strictly"),
    "ego before 1970": (_ego(timestamps_us=TIMES - 10**15), "is not a time in microseconds"),
    "ego far in the future": (_ego(timestamps_us=TIMES + 2**62), "is not a time in microseconds"),
    "ego of one pose": (
        lambda log: _ego(
            timestamps_us=log.world_from_rig.timestamps_us[:1], poses=log.world_from_rig.poses[:1]
        )(log),
        "at least two poses",
    ),
    "no ego": (lambda log: replace(log, world_from_rig=NO_POSES), "expected (1, 4, 4)"),
    "camera of another name": (_camera(name="rear"), "cameras['front'].name: is 'rear'"),
    "camera mounting": (_camera(rig_from_camera=np.full((4, 4), np.nan)), "mounting: nan"),
    "two mountings": (_camera(rig_from_camera=np.stack([np.eye(4)] * 2)), "expected (4, 4)"),
    "camera without images": (_camera(images=[]), "0 frames for 3 timestamps"),
    "mask of another size": (
        _camera(mask=np.ones((7, 5), bool)),
        "mask: expected (5, 7) bool, got (7, 5)",
    ),
    "mask of numbers": (_camera(mask=np.ones((5, 7))), "expected (5, 7) bool, got (5, 7) float64"),
    "focal length": (_intrinsics(fx=float("inf")), "fx, fy"),
    "no focal length": (_intrinsics(fy=0.0), "fx, fy"),
    "principal point": (_intrinsics(cx=float("nan")), "cx, cy"),
    "width": (_intrinsics(width=0), "width, height: 0 x 5"),
    "too large an image": (_intrinsics(width=10**6, height=10**6), "width, height"),
    "distortion": (_intrinsics(distortion=(0, 0, float("nan"), 0, 0)), "distortion"),
    "sweeps": (_lidar(sweeps=[]), "0 frames for 2 timestamps"),
    "LiDAR mounting": (_lidar(rig_from_lidar=np.diag([1, 1, -1, 1.0])), "mirror image"),
    "sensors of one name": (
        lambda log: replace(log, lidars={"front": replace(log.lidars["top"], name="front")}),
        "a camera has the same name",
    ),
    "sensor called rig": (
        lambda log: replace(log, cameras={"rig": replace(log.cameras["front"], name="rig")}),
        "a sensor cannot be called",
    ),
    "size NaN": (_track(size=np.array([4, np.nan, 1])), "size: expected three sides"),
    "size infinite": (_track(size=np.array([4, np.inf, 1])), "size: expected three sides"),
    "size negative": (_track(size=np.array([4, -1.0, 1])), "size: expected three sides"),
    "track of another id": (_track(track_id="8"), "track_id: is '8'"),
    "category": (_track(category=""), "category: a name must have 1 to 1000"),
    "track of no pose": (_track(trajectory=NO_POSES), "expected (1, 4, 4)"),
    "track out of the drive": (_late, "tracks['car 7']: outside the ego trajectory"),
    "map": (
        lambda log: replace(
            log, map=HdMap({}, (), GroundHeight(np.zeros(2), 0.0, np.zeros((1, 1))))
        ),
        "cell: 0.0",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_impossible_logs_are_refused_before_anything_is_written(case: str, tmp_path: Path) -> None:
    change, message = CASES[case]
    log = change(small_log(np.random.default_rng(7)))
    with pytest.raises(InputError) as error:
        write_log(log, tmp_path / "log")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


NEAR = np.zeros((2, 3), np.float32)
DIM = np.zeros(2, np.float32)


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        (LidarSweep(0, np.full((2, 3), np.nan, np.float32), DIM), "points: nan is not within"),
        (LidarSweep(0, NEAR + np.float32(1e30), DIM), "points: 1e+30 is not within"),
        (LidarSweep(0, NEAR[:, :2], DIM), "points: expected (N, 3)"),
        (LidarSweep(0, NEAR, DIM[:1]), "intensity: expected 2 values"),
        (LidarSweep(0, NEAR, DIM + np.float32(np.nan)), "intensity: expected 2 values"),
        (LidarSweep(0, NEAR, DIM, np.zeros(3, np.int64)), "point_timestamps_us: expected 2 times"),
        (LidarSweep(-1, NEAR, DIM), "timestamp_us: -1 is not a time"),
        (LidarSweep(0, NEAR, DIM, np.array([0, 2**60])), "is not a time"),
    ],
)
def test_impossible_sweeps_are_refused(sweep: LidarSweep, message: str) -> None:
    with pytest.raises(ValueError) as error:
        sweep.validate("sweep")
    assert message in str(error.value)


def test_images_of_another_size_are_not_written(tmp_path: Path) -> None:
    images = np.zeros((3, 7, 5, 3), np.uint8)
    with pytest.raises(InputError, match=r"images\[0\]: is \(7, 5, 3\) uint8, .* 7x5"):
        write_log(_camera(images=images)(small_log(np.random.default_rng(7))), tmp_path / "log")
    assert list(tmp_path.iterdir()) == []


def test_limits_are_beyond_any_drive() -> None:
    """Poses at the reach, boxes of the least size and times in 2250 are still a log."""
    log = small_log(np.random.default_rng(7))
    poses = log.world_from_rig.poses.copy()
    poses[:, :3, 3] = -1e7
    shift = 7_000_000_000_000_000
    moved = replace(
        log,
        cameras={},
        lidars={},
        world_from_rig=Trajectory(log.world_from_rig.timestamps_us + shift, poses),
        tracks={
            "car 7": Track(
                "car 7",
                "x" * 1000,
                np.array([1e-3, 1e3, 1.0]),
                Trajectory(log.world_from_rig.timestamps_us[:1] + shift, poses[:1]),
            )
        },
    )
    moved.validate()
