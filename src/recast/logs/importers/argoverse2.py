"""Argoverse 2 sensor logs: poses, boxes, LiDAR, cameras and HD map as a driving log.

Source: Wilson et al., "Argoverse 2: Next Generation Datasets for Self-Driving Perception and
Forecasting" (NeurIPS 2021), and the layout of the sensor dataset.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.images import ImageFiles
from recast.logs.importers.argoverse2_files import (
    INTRINSICS,
    LASERS,
    POSE,
    POSES,
    TIME,
    TURN_US,
    Argoverse2Sweeps,
    Columns,
    RigCalibration,
    TimedFiles,
    check_sensors,
    find_log,
    list_frames,
    poses,
    read_calibration,
    read_columns,
    times_of,
)
from recast.logs.importers.argoverse2_map import city_of, find_map, read_map
from recast.logs.importers.common import IMAGES, chosen_cameras, returns_valid
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    Track,
    Trajectory,
)

SIZE = ("length_m", "width_m", "height_m")
EGO = "EGO_VEHICLE"
CATEGORIES = {
    "REGULAR_VEHICLE": "car",
    "LARGE_VEHICLE": "truck",
    "BOX_TRUCK": "truck",
    "TRUCK": "truck",
    "TRUCK_CAB": "truck",
    "VEHICULAR_TRAILER": "truck",
    "BUS": "bus",
    "ARTICULATED_BUS": "bus",
    "SCHOOL_BUS": "bus",
    "RAILED_VEHICLE": "tram",
    "PEDESTRIAN": "pedestrian",
    "OFFICIAL_SIGNALER": "pedestrian",
    "STROLLER": "pedestrian",
    "WHEELCHAIR": "pedestrian",
    "BICYCLE": "cyclist",
    "BICYCLIST": "cyclist",
    "MOTORCYCLE": "cyclist",
    "MOTORCYCLIST": "cyclist",
    "WHEELED_DEVICE": "cyclist",
    "WHEELED_RIDER": "cyclist",
    "ANIMAL": "misc",
    "DOG": "misc",
    "BOLLARD": "misc",
    "CONSTRUCTION_BARREL": "misc",
    "CONSTRUCTION_CONE": "misc",
    "MESSAGE_BOARD_TRAILER": "misc",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN": "misc",
    "SIGN": "misc",
    "STOP_SIGN": "misc",
    "TRAFFIC_LIGHT_TRAILER": "misc",
}
"""The dataset's categories; the ego's own box, which some files hold, is left out."""

BOX_DELAY_US = 54_000
"""When a box holds after its sweep's time: in the middle of the turn.

Boxes enclose the points as scanned, and both scanners, half a turn apart, meet every object: on
average in the middle of the turn, whatever its direction. Measured on real logs: the points of
both scanners fall onto each other when moved to their own times; box faces then lie best after 50
to 60 ms; and the paths of boxes are smooth to 5 mm over a second, without the jumps that times by
direction would bring in.
"""
_FARTHEST = 500.0
"""Metres from the ego: boxes are in its frame, and no LiDAR sees farther."""
LICENCE = "CC BY-NC-SA 4.0"

AXLE_HEIGHT = 0.32
"""Metres from the ground to the rear axle, the origin of the dataset's ego frame: of LiDAR ground
and of the ground raster under the ego alike (its makers say 0.33)."""
RIG_FROM_EGO = se3.from_rotation_translation(np.eye(3), [0.0, 0.0, AXLE_HEIGHT])
LONGEST_GAP_US = 1_000_000


def read_tracks(path: Path, world_from_rig: Trajectory, rig_from_ego: Array) -> dict[str, Track]:
    """Tracks by id, each box placed with the ego pose of its own sweep.

    A box holds `BOX_DELAY_US` after its sweep's time. A labelled sweep counts as its whole turn:
    the first and last boxes are continued to its ends, as far as the ego trajectory goes.

    Raises:
        InputError: the file, a column or a value is wrong, a category is unknown, a box has a time
            without ego pose or comes twice, or boxes are not in the ego's frame.
    """
    rows = read_columns(path, (TIME, *SIZE, *POSE), ("track_uuid", "category"))
    ego_from_box = poses(path, rows)
    times = times_of(path, rows) // 1000
    size = np.stack([rows[name].astype(np.float64) for name in SIZE], axis=-1)
    _check(path, rows, times, size, ego_from_box, world_from_rig)
    placed = world_from_rig.at(times) @ rig_from_ego @ ego_from_box

    tracks = {}
    wanted = rows["category"] != EGO
    for name in dict.fromkeys(rows["track_uuid"][wanted].tolist()):
        mine = np.flatnonzero(wanted & (rows["track_uuid"] == name))
        mine = mine[np.argsort(times[mine], kind="stable")]
        twice = np.flatnonzero(np.diff(times[mine]) <= 0)
        if len(twice):
            raise InputError(
                path,
                f"timestamp_ns in row {mine[twice[0] + 1]}",
                f"appears twice for track {name}",
                "keep one box for each track and time",
            )
        category = CATEGORIES[str(rows["category"][mine[0]])]
        trajectory = _whole_turns(times[mine], placed[mine], world_from_rig)
        if trajectory is not None:
            tracks[name] = Track(name, category, np.median(size[mine], axis=0), trajectory)
    return tracks


def _whole_turns(sweeps_us: Int64Array, boxes: Array, ego: Trajectory) -> Trajectory | None:
    """The path of boxes (N, 4, 4) of sweeps (N,); None where no ego pose is late enough."""
    times = sweeps_us + BOX_DELAY_US
    last = int(ego.timestamps_us[-1])
    kept = times <= last
    if not np.any(kept):
        return None
    path = Trajectory(times[kept], boxes[kept])
    return motion.extended(path, int(sweeps_us[0]), min(int(sweeps_us[kept][-1]) + TURN_US, last))


def _check(
    path: Path,
    rows: Columns,
    times: Int64Array,
    size: Array,
    ego_from_box: Array,
    world_from_rig: Trajectory,
) -> None:
    known = np.isin(rows["category"], [*CATEGORIES, EGO])
    if not known.all():
        row = int(np.argmin(known))
        raise InputError(
            path,
            f"category in row {row}",
            f"{str(rows['category'][row])!r} is not a category of Argoverse 2",
            f"use one of {', '.join(CATEGORIES)}",
        )
    wrong = ~checks.are_box_sides(size)
    if wrong.any():
        row, axis = np.argwhere(wrong)[0]
        raise InputError(
            path, f"{SIZE[axis]} in row {row}", f"is {size[row, axis]:g} m", "remove the box"
        )
    first, last = world_from_rig.timestamps_us[[0, -1]]
    outside = np.flatnonzero((times < first) | (times > last))
    if len(outside):
        raise InputError(
            path,
            f"timestamp_ns in row {outside[0]}",
            f"{rows['timestamp_ns'][outside[0]]} lies outside the log's ego poses",
            "use the annotations of this log",
        )
    distance = np.linalg.norm(ego_from_box[:, :3, 3], axis=1)
    if np.any(distance > _FARTHEST):
        row = int(np.argmax(distance > _FARTHEST))
        raise InputError(
            path,
            f"tx_m, ty_m, tz_m in row {row}",
            f"the box is {distance[row]:.0f} m from the ego, so it is not in the ego's frame",
            "give boxes in the ego frame of their sweep",
        )


@returns_valid
def load_argoverse2(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read an Argoverse 2 sensor log with its map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the log, or the splits (train, val, test).
        drive: the log's id.
        labels: annotations in the dataset's own format, if they lie apart from the log.
        cameras: names of the cameras to read, such as ring_front_center; all if empty.

    Raises:
        InputError: files are missing, broken or do not belong together.
    """
    folder = find_log(Path(root), drive)
    calibration = _calibration(folder)
    sweeps = list_frames(folder / "sensors" / "lidar", ".feather")
    images = {
        name: list_frames(folder / "sensors" / "cameras" / name, *IMAGES)
        for name in calibration.cameras
    }
    chosen = chosen_cameras(folder, images, cameras)
    trajectory, offset = _ego(folder, sweeps, images)
    annotations = _annotations(folder) if labels is None else Path(labels)
    tracks = {} if annotations is None else read_tracks(annotations, trajectory, RIG_FROM_EGO)
    return DrivingLog(
        name=folder.name,
        cameras={name: _camera(name, calibration, images[name], trajectory) for name in chosen},
        lidars=_lidars(calibration, sweeps, trajectory),
        world_from_rig=trajectory,
        tracks=tracks,
        map=read_map(folder, trajectory.poses[:, :2, 3], offset),
        world_offset=offset,
        metadata={
            "dataset": "Argoverse 2 sensor",
            "drive": folder.name,
            "city": city_of(find_map(folder)),
            "licence": LICENCE,
        },
    )


def _calibration(folder: Path) -> RigCalibration:
    if not (folder / "calibration").is_dir() and not (folder / "sensors").is_dir():
        return RigCalibration({}, {})
    calibration = read_calibration(folder / "calibration")
    check_sensors(folder, calibration)
    return calibration


def _annotations(folder: Path) -> Path | None:
    """The log's own boxes; logs of the test split have none."""
    names = ("annotations.feather", "annotations_with_ego.feather")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _ego(
    folder: Path, sweeps: TimedFiles, images: dict[str, TimedFiles]
) -> tuple[Trajectory, Array]:
    """The ego trajectory (of the rig frame, near the origin) and the offset taken off it."""
    path = folder / POSES
    rows = read_columns(path, (TIME, *POSE))
    times = times_of(path, rows)
    city_from_ego = poses(path, rows)
    if len(times) < 2:
        raise InputError(
            path, "rows", f"there are {len(times)} poses, 2 are needed", "download it again"
        )
    steps = np.diff(times)
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0)) + 1
        field = f"{TIME} in row {row}"
        raise InputError(path, field, "is not later than the row before", "download it again")
    if np.any(steps > 1000 * LONGEST_GAP_US):
        row = int(np.argmax(steps))
        problem = f"the next pose is {steps[row] / 1e9:.1f} s later"
        raise InputError(path, f"{TIME} in row {row}", problem, "use a log without the gap")
    # Poses of two clocks are merged in the files: some are a nanosecond apart.
    times_us, first = np.unique(times // 1000, return_index=True)
    world_from_rig = (city_from_ego @ se3.inverse(RIG_FROM_EGO))[first]
    offset: Array = world_from_rig[0, :3, 3].copy()
    world_from_rig[:, :3, 3] -= offset
    sensed = [listed.timestamps_us for listed in (sweeps, *images.values())]
    sensed.append(sweeps.timestamps_us + TURN_US)
    spanned = np.concatenate([*sensed, times_us[[0, -1]]])
    trajectory = Trajectory(times_us, world_from_rig)
    return motion.extended(trajectory, int(spanned.min()), int(spanned.max())), offset


def _camera(
    name: str, calibration: RigCalibration, listed: TimedFiles, trajectory: Trajectory
) -> CameraStream:
    camera = calibration.cameras[name]
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    kept = listed.within(first, last)
    return CameraStream(
        name=name,
        camera=camera,
        rig_from_camera=RIG_FROM_EGO @ calibration.ego_from_sensor[name],
        timestamps_us=kept.timestamps_us,
        images=ImageFiles(kept.paths, camera.width, camera.height, INTRINSICS),
    )


def _lidars(
    calibration: RigCalibration, sweeps: TimedFiles, trajectory: Trajectory
) -> dict[str, LidarStream]:
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    kept = sweeps.within(first, last - TURN_US)
    if not kept.paths:
        return {}
    return {
        name: LidarStream(
            name,
            RIG_FROM_EGO @ calibration.ego_from_sensor[name],
            kept.timestamps_us,
            Argoverse2Sweeps(kept, lasers, calibration.ego_from_sensor[name], RIG_FROM_EGO),
        )
        for name, lasers in LASERS.items()
    }
