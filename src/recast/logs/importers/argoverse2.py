"""Argoverse 2 sensor logs: cameras, sweeps and boxes; the vector map and the raster of heights."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.core.table_files import read_npy
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.hdmap import GroundHeight, HdMap, Lane
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
from recast.logs.importers.common import (
    IMAGES,
    NEAR,
    ForeignRecord,
    chosen_cameras,
    lane_outline,
    metres_beside,
    returns_valid,
)
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    Track,
    Trajectory,
)

_STEP = 1.0
"""Metres between points of an averaged centreline, measured on the longer boundary."""
_LONGEST = 20_000.0
"""Metres of a lane's boundary; those of the dataset have a few hundred at the most."""
_LARGEST_RASTER = 1 << 26
"""Bytes; those of the dataset have one or two million."""
_MEND = "download the log's map again"


_Metres = Annotated[float, Field(ge=-checks.WORLD_REACH, le=checks.WORLD_REACH)]


class _Point(ForeignRecord):
    x: _Metres
    y: _Metres
    z: _Metres


class _Lane(ForeignRecord):
    id: int
    is_intersection: bool
    lane_type: Literal["VEHICLE", "BUS", "BIKE"]
    left_lane_boundary: list[_Point]
    right_lane_boundary: list[_Point]
    successors: list[int]
    left_neighbor_id: int | None
    right_neighbor_id: int | None


class _Area(ForeignRecord):
    area_boundary: list[_Point]


class _Map(ForeignRecord):
    lane_segments: dict[str, _Lane]
    drivable_areas: dict[str, _Area]


class _Sim2(ForeignRecord):
    R: tuple[float, float, float, float]
    t: tuple[float, float]
    s: float


def find_map(log: Path) -> Path:
    """The vector map of a log. Raises InputError: there is none."""
    path = _one(log / "map", "log_map_archive_*.json")
    if path is None:
        raise InputError(log / "map", "log_map_archive_*.json", "is missing", _MEND)
    return path


def city_of(path: Path) -> str:
    """The city in a vector map's name, such as "PIT"; empty where it has none."""
    found = re.search(r"____([A-Z]+)_city", path.name)
    return found[1] if found else ""


def read_map(log: Path, ego: Array, offset: Array) -> HdMap:
    """Lanes for cars, drivable area and ground height of a log, in its world frame.

    Bicycle lanes are left out, and neighbours of the other direction. Centrelines are not stored;
    they are the mean of both boundaries at equal shares of their lengths.

    Args:
        log: the log's folder.
        ego: (T, 2) positions of the ego, world frame.
        offset: (3,) city coordinates = world coordinates + offset.

    Raises:
        InputError: a file or field is missing or wrong, there is no lane for cars, or the map lies
            elsewhere than the drive.
    """
    path = find_map(log)
    try:
        model = _Map.model_validate(files.read_json(path))
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None
    driven = {
        str(lane.id): lane for lane in model.lane_segments.values() if lane.lane_type != "BIKE"
    }
    if not driven:
        raise InputError(path, "lane_segments", "contains no lane for cars", _MEND)
    lines = {
        key: tuple(
            _line(path, f"lane_segments.{key}.{side}_lane_boundary", points, offset)
            for side, points in (
                ("left", lane.left_lane_boundary),
                ("right", lane.right_lane_boundary),
            )
        )
        for key, lane in driven.items()
    }
    lanes = {key: _lane(key, driven, lines) for key in driven}
    _check_place(path, lanes, ego)
    areas = []
    for name, area in model.drivable_areas.items():
        outline = _coordinates(area.area_boundary, offset)[:, :2]
        if len(outline) < 3:
            field = f"drivable_areas.{name}.area_boundary"
            raise InputError(path, field, f"has {len(outline)} points, 3 are needed", _MEND)
        areas.append(outline)
    city = city_of(path)
    return HdMap(
        lanes=lanes,
        drivable_area=tuple(areas),
        ground=_read_ground(log / "map", offset),
        notes={"source": "Argoverse 2", **({"city": city} if city else {})},
    )


def _one(folder: Path, pattern: str) -> Path | None:
    return next(iter(sorted(folder.glob(pattern))), None)


def _coordinates(points: list[_Point], offset: Array) -> Array:
    return np.array([(p.x, p.y, p.z) for p in points], np.float64).reshape(-1, 3) - offset


def _line(path: Path, field: str, points: list[_Point], offset: Array) -> Array:
    line = _coordinates(points, offset)
    if len(line) < 2 or not np.any(np.ptp(line[:, :2], axis=0) > 0):
        raise InputError(path, field, "has fewer than two distinct points", _MEND)
    length = float(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1).sum())
    if length > _LONGEST:  # it is resampled every metre
        raise InputError(
            path, field, f"is {length:.0f} m long, longer than {_LONGEST:.0f} m", _MEND
        )
    return line


def _lane(key: str, lanes: dict[str, _Lane], lines: dict[str, tuple[Array, ...]]) -> Lane:
    lane, (left, right) = lanes[key], lines[key]
    centre = _mean_line(left, right)

    def same_way(other: int | None) -> str | None:
        if other is None or str(other) not in lanes:
            return None
        theirs = _mean_line(*lines[str(other)])
        along = (centre[-1] - centre[0])[:2] @ (theirs[-1] - theirs[0])[:2]
        return str(other) if along > 0 else None

    return Lane(
        lane_id=key,
        centreline=centre,
        left_boundary=left,
        right_boundary=right,
        polygon=lane_outline(left, right),
        successors=tuple(str(other) for other in lane.successors if str(other) in lanes),
        left_neighbour=same_way(lane.left_neighbor_id),
        right_neighbour=same_way(lane.right_neighbor_id),
        is_intersection=lane.is_intersection,
    )


def _mean_line(left: Array, right: Array) -> Array:
    """Points (N, 3) midway between two lines, at equal shares of their lengths."""
    steps = [np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1) for line in (left, right)]
    lengths = [np.concatenate([[0.0], np.cumsum(step)]) for step in steps]
    longest = max(length[-1] for length in lengths)
    share = np.linspace(0.0, 1.0, int(np.ceil(longest / _STEP)) + 1)
    sides = [
        np.stack([np.interp(share * length[-1], length, line[:, k]) for k in range(3)], axis=-1)
        for line, length in zip((left, right), lengths, strict=True)
    ]
    return (sides[0] + sides[1]) / 2


def _check_place(path: Path, lanes: dict[str, Lane], ego: Array) -> None:
    distance = metres_beside(lanes, ego)
    if distance > NEAR:
        raise InputError(
            path,
            "lane_segments",
            f"the ego drives {distance:.0f} m away from all lanes: the map is of another log, or "
            "in other coordinates",
            "use the map and the poses of the same log, both in city coordinates",
        )


def _read_ground(folder: Path, offset: Array) -> GroundHeight | None:
    """The ground raster, or None where the log has none."""
    raster, placing = (
        _one(folder, pattern)
        for pattern in ("*_ground_height_surface____*.npy", "*___img_Sim2_city.json")
    )
    if raster is None and placing is None:
        return None
    if raster is None or placing is None:
        missing = "*_ground_height_surface____*.npy" if raster is None else "*___img_Sim2_city.json"
        raise InputError(folder, missing, "is missing", _MEND)
    height = read_npy(raster, _MEND, _LARGEST_RASTER)
    if height.ndim != 2 or not np.issubdtype(height.dtype, np.floating) or not height.size:
        problem = f"is {height.dtype} of shape {height.shape}, not two-dimensional numbers"
        raise InputError(raster, "array", problem, _MEND)
    try:
        sim2 = _Sim2.model_validate(files.read_json(placing))
    except ValidationError as error:
        raise validation_error(placing, error, _MEND) from None
    if not np.allclose(sim2.R, (1.0, 0.0, 0.0, 1.0), atol=1e-9) or sim2.s <= 0:
        problem = (
            f"a raster turned by {json.dumps(sim2.R)} or scaled by {sim2.s:g} is not supported"
        )
        raise InputError(placing, "R, s", problem, _MEND)
    # A place p of the city lies in cell floor(s (p + t)), so the first centre is at 0.5 / s - t.
    cell = 1.0 / sim2.s
    above = np.where(np.isfinite(height), height, np.nan).astype(np.float64) - offset[2]
    return GroundHeight(
        origin=cell / 2 - np.array(sim2.t) - offset[:2],
        cell=cell,
        height=np.round(above, 3),  # half floats come in steps of centimetres
    )


# Argoverse 2 sensor logs: poses, boxes, LiDAR, cameras and HD map as a driving log.
#
# Source: Wilson et al., "Argoverse 2: Next Generation Datasets for Self-Driving Perception and
# Forecasting" (NeurIPS 2021), and the layout of the sensor dataset.

SIZE = ("length_m", "width_m", "height_m")
EGO = "EGO_VEHICLE"
CATEGORIES = {
    "REGULAR_VEHICLE": "car",
    "LARGE_VEHICLE": "truck",
    "BOX_TRUCK": "truck",
    "TRUCK": "truck",
    "TRUCK_CAB": "truck",
    "VEHICULAR_TRAILER": "trailer",
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
    "MOTORCYCLE": "motorcyclist",
    "MOTORCYCLIST": "motorcyclist",
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
