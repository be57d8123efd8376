"""Folders of Street Gaussians as logs: times and places of the frames, LiDAR sweeps, and tracks.

Every image has its own time and ego pose. A whole frame (its boxes and points) has the vehicle's
pose at the middle of the scan, but timestamps.json gives it the time at which the scan began,
about 50 ms earlier: the delay is measured by looking where on the images' path the pose lies.

The original pointcloud.npz is a pickle: loading it would run whatever code is in it, so it is
refused; one that was converted to plain arrays is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np

from recast.core import files
from recast.core.errors import InputError
from recast.core.files import read_text
from recast.core.table_files import npz_names, read_npz
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.importers.common import are_returns, chosen_cameras, first_jump, returns_valid
from recast.logs.importers.waymo_proto import LICENCE
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)
from recast_bridges.logs.processed_folder import (
    FARTHEST,
    NUMBER,
    CameraFolder,
    find_scene,
    frame_numbers,
    read_cameras,
    read_pose,
)

TIMES = "timestamps.json"
USUAL_DELAY_US = 50_000
LONGEST_DELAY_US = 100_000
_DELAY_STEP_US = 1_000
_SHORTEST_PATH = 5.0
"""Metres: an ego that stands tells nothing about times."""
_BESIDE = 1.0
"""Metres that a frame's pose may be off the path of the images."""
_MEND_FRAMES = "process the scene again"
NAME = "lidar"
RIG_FROM_LIDAR = se3.from_rotation_translation(np.eye(3), [1.43, 0.0, 2.18])
"""About where Waymo's top LiDAR stands: the file does not say which of five saw a point."""
_LARGEST = 1 << 28
"""Bytes of a sweep."""
_CONVERT = (
    "convert it, or remove it to do without LiDAR; "
    "see docs/data.md#street-gaussians-processed-scenes"
)


@dataclass(frozen=True)
class TrainedFrames:
    """Times and poses of a scene."""

    world_from_rig: Trajectory  # ego trajectory through the poses of all images
    offset: Array  # (3,) global coordinates = world coordinates + offset
    frame_times: dict[int, int]  # microseconds by frame: when its boxes and points hold
    # (4, 4) vehicle pose by frame; boxes and points are given in it.
    world_from_frame: dict[int, Array]
    image_times: dict[int, dict[int, int]]  # microseconds by camera number, then by frame


def read_drive(scene: Path, cameras: Sequence[CameraFolder]) -> TrainedFrames:
    """Read timestamps.json and ego_pose. Raises InputError: a file or time is missing or wrong, or
    poses are not all of one frame."""
    if not cameras:
        raise InputError(scene / "images", "images", "there are none", _MEND_FRAMES)
    times = files.read_json(scene / TIMES)
    poses = scene / "ego_pose"
    image_times = {
        camera.number: {k: _time(scene / TIMES, times, camera.name, k) for k in camera.images}
        for camera in cameras
    }
    timed = sorted(
        (time, poses / f"{frame:06d}_{number}.txt")
        for number, of_camera in image_times.items()
        for frame, time in of_camera.items()
    )
    all_times = np.array([time for time, _ in timed], np.int64)
    placed = np.stack([read_pose(path) for _, path in timed])
    jump = first_jump(all_times, placed)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the image before: mixed coordinate frames"
        raise InputError(timed[jump[0]][1], "matrix", problem, _MEND_FRAMES)
    unique, first = np.unique(all_times, return_index=True)
    offset: Array = placed[0, :3, 3].copy()
    placed[:, :3, 3] -= offset
    images = Trajectory(unique, placed[first])

    frames = frame_numbers(poses)
    began = {frame: _time(scene / TIMES, times, "FRAME", frame) for frame in frames}
    world_from_frame = {frame: read_pose(path) for frame, path in frames.items()}
    for pose in world_from_frame.values():
        pose[:3, 3] -= offset
    starts = np.array(list(began.values()), np.int64)
    late = np.flatnonzero(np.diff(starts) <= 0)
    if len(late):
        field = f"FRAME.{list(began)[late[0] + 1]:06d}"
        raise InputError(scene / TIMES, field, "is not later than the frame before", _MEND_FRAMES)
    delay = _delay(starts, np.stack(list(world_from_frame.values())), images)
    frame_times = {frame: time + delay for frame, time in began.items()}
    spanned = [*frame_times.values(), int(unique[0]), int(unique[-1])]
    trajectory = motion.extended(images, min(spanned), max(spanned))
    for frame, path in frames.items():
        if not trajectory.covers(frame_times[frame]):
            problem = "lies outside the times of all images"
            raise InputError(scene / TIMES, f"FRAME.{path.stem}", problem, _MEND_FRAMES)
        beside = trajectory.at(frame_times[frame])[:3, 3] - world_from_frame[frame][:3, 3]
        if (distance := float(np.linalg.norm(beside))) > _BESIDE:
            problem = f"is {distance:.0f} m from the path of the images: mixed coordinate frames"
            raise InputError(path, "matrix", problem, _MEND_FRAMES)
    return TrainedFrames(trajectory, offset, frame_times, world_from_frame, image_times)


def _time(path: Path, times: Any, sensor: str, frame: int) -> int:
    """Microseconds of `times[sensor][frame]`, which are seconds."""
    of_sensor = times.get(sensor) if isinstance(times, dict) else None
    seconds = of_sensor.get(f"{frame:06d}") if isinstance(of_sensor, dict) else None
    if not isinstance(seconds, (int, float)) or not 0 <= seconds < 1e10:
        problem = "is missing" if seconds is None else f"{json.dumps(seconds)} is not a time"
        raise InputError(path, f"{sensor}.{frame:06d}", problem, _MEND_FRAMES)
    return round(seconds * 1e6)


def _delay(starts_us: Int64Array, world_from_frame: Array, images: Trajectory) -> int:
    """Microseconds from the beginning of a scan to the time of the frame's pose."""
    path = np.linalg.norm(np.diff(images.poses[:, :3, 3], axis=0), axis=1).sum()
    first, last = images.timestamps_us[[0, -1]]
    inside = (starts_us >= first) & (starts_us + LONGEST_DELAY_US <= last)
    if path < _SHORTEST_PATH or not inside.any():
        return USUAL_DELAY_US
    delays = np.arange(0, LONGEST_DELAY_US + 1, _DELAY_STEP_US)
    on_path = images.at(starts_us[inside][:, None] + delays)[..., :3, 3]
    away = np.linalg.norm(on_path - world_from_frame[inside, None, :3, 3], axis=-1)
    return int(delays[np.argmin(np.median(away, axis=0))])


def read_lidar(path: Path, drive: TrainedFrames) -> dict[str, LidarStream]:
    """The sweeps of a file of one array (N, 3) for each frame; none where there is no such file.
    Raises InputError: the file is broken or holds pickled objects, or a frame is unknown."""
    if not path.is_file():
        return {}
    if not is_zipfile(path):
        raise InputError(path, "file", "is not an .npz archive; pickles are never loaded", _CONVERT)
    names = npz_names(path, _CONVERT)
    if names:
        _array(path, names[0])
    for name in names:
        if not NUMBER.fullmatch(name) or int(name) not in drive.frame_times:
            problem = "is not a frame with an ego pose"
            raise InputError(path, f"array {name}", problem, "use the points of this scene")
    names.sort(key=int)
    times = np.array([drive.frame_times[int(name)] for name in names], np.int64)
    sweeps = StreetGaussiansSweeps(path, tuple(names), drive)
    return {NAME: LidarStream(NAME, RIG_FROM_LIDAR, times, sweeps)}


@dataclass(frozen=True)
class StreetGaussiansSweeps:
    """Sweeps read from the file on demand; a `SweepSource`. They have no intensity: it is zero."""

    path: Path  # .npz file
    names: tuple[str, ...]  # S arrays in it, named by frame
    drive: TrainedFrames  # times and poses

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.names)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`. Raises InputError: the file is broken, or the array is not (N, 3)
        numbers in range."""
        name = self.names[index]
        in_vehicle = _array(self.path, name)
        time = self.drive.frame_times[int(name)]
        rig_from_world = se3.inverse(self.drive.world_from_rig.at(time))
        rig_from_vehicle = rig_from_world @ self.drive.world_from_frame[int(name)]
        points = se3.apply(rig_from_vehicle, in_vehicle).astype(np.float32)
        return LidarSweep(time, points, np.zeros(len(points), np.float32))


def _array(path: Path, name: str) -> Array:
    points = read_npz(path, _CONVERT, [name], _LARGEST)[name]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        problem = f"is {points.dtype} of shape {points.shape}, not points (N, 3)"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    points = points[are_returns(points, RIG_FROM_LIDAR[:3, 3])]
    if not np.all(np.abs(points) <= checks.SENSOR_REACH):
        problem = f"holds a point not within {checks.SENSOR_REACH:g} m"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    return points.astype(np.float64)


# Street Gaussians' processed Waymo scenes: poses, boxes, points and images as a driving log.
#
# Source: Yan et al., "Street Gaussians: Modeling Dynamic Urban Scenes with Gaussian Splatting"
# (ECCV 2024), and the layout that its preprocessing writes.

CATEGORIES = {"vehicle": "car", "pedestrian": "pedestrian", "cyclist": "cyclist"}
"""Ours by the classes of the file that are reconstructed; it may hold others."""
_COLUMNS = (11, 12)  # frame track class alpha h w l cx cy cz heading [speed]
LEFT_OUT = ("sign", "misc")
_MEND = "process the scene again, or name another file with `labels`"


@returns_valid
def load_street_gaussians(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a processed Waymo scene, without a map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the scenes, or the scene itself.
        drive: the scene's folder, such as 002.
        labels: another file in the format of track/track_info.txt, such as a tracker's.
        cameras: Waymo's names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, broken, hold pickled objects or do not belong together.
    """
    scene = find_scene(Path(root), drive, "Street Gaussians")
    mounted = {camera.name: camera for camera in read_cameras(scene)}
    chosen = chosen_cameras(scene, mounted, cameras)
    timed = read_drive(scene, list(mounted.values()))
    tracks = scene / "track" / "track_info.txt" if labels is None else Path(labels)
    return DrivingLog(
        name=f"street-gaussians {drive}",
        cameras={name: _camera(scene, mounted[name], timed) for name in chosen},
        lidars=read_lidar(scene / "pointcloud.npz", timed),
        world_from_rig=timed.world_from_rig,
        tracks=read_tracks(tracks, timed),
        world_offset=timed.offset,
        metadata={
            "dataset": "Waymo, processed by Street Gaussians",
            "drive": drive,
            "licence": LICENCE,
        },
    )


def _camera(scene: Path, camera: CameraFolder, drive: TrainedFrames) -> CameraStream:
    times = drive.image_times[camera.number]
    ordered = sorted(times, key=lambda frame: times[frame])
    stamps = np.array([times[frame] for frame in ordered], np.int64)
    if np.any(np.diff(stamps) == 0):
        frame = ordered[int(np.argmin(np.diff(stamps))) + 1]
        problem = "is the time of another image"
        field = f"{camera.name}.{frame:06d}"
        raise InputError(scene / "timestamps.json", field, problem, "process the scene again")
    return camera.stream(camera.extrinsic, times)


@dataclass(frozen=True)
class BoxRow:
    """One line."""

    where: str  # the line, for messages
    frame: int  # number of the frame
    track: str  # track number, as written
    kind: str  # class in lower case, whatever it is
    size: Array  # (3,) length, width, height in metres, not checked
    centre: Array  # (3,) metres, vehicle frame at the frame's time
    heading: float  # radians, counter-clockwise from the vehicle's x axis


def read_box_rows(path: Path, mend: str) -> Iterator[BoxRow]:
    """All rows in the order of the file.

    Args:
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, or a line has too few or too many columns, or something
            else than numbers in range.
    """
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    is_first = True
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.partition("#")[0].split()
        if words and not (is_first and not words[0].isdecimal()):  # it names the columns
            yield _row(path, f"line {number}", words, mend)
        is_first = is_first and not words


def _row(path: Path, where: str, words: list[str], mend: str) -> BoxRow:
    if len(words) not in _COLUMNS:
        raise InputError(path, where, f"has {len(words)} columns, not 11 or 12", mend)
    try:
        frame = int(words[0])
        height, width, length, x, y, z, heading = (float(word) for word in words[4:11])
    except ValueError:
        raise InputError(path, where, "contains text where numbers are expected", mend) from None
    if not np.all(np.abs([height, width, length, x, y, z, heading]) <= checks.WORLD_REACH):
        problem = f"holds NaN or infinity, or a number not within {checks.WORLD_REACH:g}"
        raise InputError(path, where, problem, mend)
    size, centre = np.array([length, width, height]), np.array([x, y, z])
    return BoxRow(where, frame, words[1], words[2].lower(), size, centre, heading)


def read_tracks(path: Path, drive: TrainedFrames) -> dict[str, Track]:
    """Tracks by the file's own numbers, each box placed with its frame's vehicle pose. Raises
    InputError: the file is missing, a line has too few or wrong values, an unknown class or frame,
    a box comes twice, or is not in the vehicle's frame."""
    grouped: dict[str, dict[int, BoxRow]] = {}
    for row in read_box_rows(path, _MEND):
        _check(path, row, drive)
        if row.kind in LEFT_OUT:
            continue
        track = grouped.setdefault(row.track, {})
        if row.frame in track:
            problem = f"track {row.track} appears twice in frame {row.frame}"
            raise InputError(path, f"{row.where}: track", problem, "keep one of them")
        track[row.frame] = row
    tracks = {}
    for name, boxes in grouped.items():
        frames = sorted(boxes)
        times = np.array([drive.frame_times[frame] for frame in frames], np.int64)
        poses = [
            drive.world_from_frame[frame] @ _vehicle_from_box(boxes[frame]) for frame in frames
        ]
        size = np.median([boxes[frame].size for frame in frames], axis=0)
        category = CATEGORIES[boxes[frames[0]].kind]
        tracks[name] = Track(name, category, size, Trajectory(times, np.stack(poses)))
    return tracks


def _vehicle_from_box(row: BoxRow) -> Array:
    return se3.from_rotation_translation(se3.rotation_z(row.heading), row.centre)


def _check(path: Path, row: BoxRow, drive: TrainedFrames) -> None:
    if row.kind not in (*CATEGORIES, *LEFT_OUT):
        raise InputError(path, f"{row.where}: class", f"{row.kind!r} is unknown", _MEND)
    if row.frame not in drive.frame_times:
        problem = f"{row.frame} has no ego_pose/{row.frame:06d}.txt"
        raise InputError(path, f"{row.where}: frame", problem, "use the tracks of this scene")
    if not checks.are_box_sides(row.size).all():
        raise InputError(path, f"{row.where}: size", "is not a valid box size", "remove the box")
    if (distance := float(np.linalg.norm(row.centre))) > FARTHEST:
        problem = f"the box is {distance:.0f} m from the ego: not in the vehicle's frame"
        raise InputError(path, f"{row.where}: centre", problem, "give boxes in the vehicle frame")
