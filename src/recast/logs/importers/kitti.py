"""KITTI raw drives, with boxes of tracking label files or of tracklet_labels.xml.

Boxes were drawn on sweeps as recorded, smeared by the ego motion of the turn. So a box of frame i
holds, like the points in it, at the moment at which the scanner pointed there in turn i.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import BOX_SIDE, SENSOR_REACH, check_reach, refused
from recast.logs.derive_map import derive_map, ego_path
from recast.logs.images import ImageFiles
from recast.logs.importers import kitti_files
from recast.logs.importers.common import IMAGES, chosen_cameras, first_jump, returns_valid
from recast.logs.importers.kitti_files import (
    TEXT_LIMIT,
    KittiCalibration,
    KittiDrive,
    SensorFiles,
    VelodyneSweeps,
    VelodyneTurns,
    firing_times,
    list_turns,
    poses_from_oxts,
    read_calibration,
    read_oxts,
    turn_times,
)
from recast.logs.motion import all_track_points, heading_offset, refine_trajectory
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    Track,
    Trajectory,
)

MOST_FRAMES = 10_000_000
"""Frames of a drive: eleven days of them."""

CATEGORIES = {
    "car": "car",
    "van": "van",
    "truck": "truck",
    "bus": "bus",
    "pedestrian": "pedestrian",
    "person": "pedestrian",
    "person_sitting": "pedestrian",
    "person (sitting)": "pedestrian",
    "cyclist": "cyclist",
    "tram": "tram",
    "misc": "misc",
}
RANGE = 40.0  # metres; farther boxes can be empty, hidden behind others
SWEEP_US = 60_000  # a label and its sweep are less than half a turn apart
MIN_POINTS = 5
MIN_BOXES = 5
MIN_FRACTION = 0.5  # right labels fill nearly all; shifted or mirrored ones a third or less


@dataclass(frozen=True)
class LabelledTrack:
    """Boxes of one object in the sensor frame they were labelled in."""

    track_id: str
    category: str
    frames: Int64Array  # (F,) frame numbers, ascending
    sensor_from_box: Array  # (F, 4, 4), origin at the box centre, x forward, z up
    size: Array  # (3,) length, width, height in metres


def read_tracking_labels(path: Path) -> list[LabelledTrack]:
    """Read a KITTI tracking label file: boxes in the rectified frame of camera 0.

    A row: frame, track, type, truncated, occluded, alpha, image box (4), height, width, length,
    x, y, z of the bottom centre, rotation_y. DontCare rows are skipped. Source: KITTI tracking
    development kit, readme.txt.

    Raises:
        InputError: missing, or a row is malformed.
    """
    rows: dict[int, list[tuple[str, Array]]] = {}
    for number, line in enumerate(files.read_text(path, TEXT_LIMIT).split("\n"), start=1):
        words = line.partition("#")[0].split()
        if not words or words[2:3] == ["DontCare"]:
            continue
        mend = "name a KITTI tracking label file (17 columns)"
        if len(words) < 17:
            raise InputError(
                path, f"line {number}", f"has {len(words)} columns, 17 are needed", mend
            )
        try:
            frame, track = int(words[0]), int(words[1])
            values = np.array([float(word) for word in words[10:17]])
        except ValueError as error:
            raise InputError(path, f"line {number}", str(error), mend) from None
        if not 0 <= frame < MOST_FRAMES:
            raise InputError(path, f"line {number}", f"frame {frame} is not a frame number", mend)
        with refused(path, mend):
            _check_box(f"line {number}", values[:3], values[3:])
        category = _category(words[2], path, f"line {number}")
        rows.setdefault(track, []).append((category, np.array([frame, *values])))
    return [_tracking_track(path, track, rows[track]) for track in sorted(rows)]


def _check_box(where: str, size: Array, places: Array) -> None:
    """Check sides (3,), and places (..., 4) in metres with a heading in radians."""
    least, most = BOX_SIDE
    if not np.all((size >= least) & (size <= most)):
        raise ValueError(f"{where}: a box must have three sides of {least} to {most} m")
    check_reach(f"{where}: position", places[..., :3], SENSOR_REACH)
    check_reach(f"{where}: heading", places[..., 3], SENSOR_REACH)


def _tracking_track(path: Path, track: int, rows: list[tuple[str, Array]]) -> LabelledTrack:
    values = np.array(sorted((row for _, row in rows), key=lambda row: row[0]))
    frames: Int64Array = values[:, 0].astype(np.int64)
    if np.any(np.diff(frames) == 0):
        twice = frames[np.flatnonzero(np.diff(frames) == 0)[0]]
        raise InputError(
            path, f"track {track}", f"appears twice in frame {twice}", "remove one of the two rows"
        )
    height, width, length = np.median(values[:, 1:4], axis=0)
    cos, sin, zero = np.cos(values[:, 7]), np.sin(values[:, 7]), np.zeros(len(values))
    forward = np.stack([cos, zero, -sin], axis=-1)
    left = np.stack([sin, zero, cos], axis=-1)
    up = np.broadcast_to([0.0, -1.0, 0.0], forward.shape)
    rotation = np.stack([forward, left, up], axis=-1)
    centre = values[:, 4:7] + up * (values[:, 1:2] / 2)
    return LabelledTrack(
        track_id=str(track),
        category=rows[0][0],
        frames=frames,
        sensor_from_box=se3.from_rotation_translation(rotation, centre),
        size=np.array([length, width, height]),
    )


def read_tracklets(path: Path) -> list[LabelledTrack]:
    """Read tracklet_labels.xml: boxes in the velodyne frame; a track id is its place in the file.

    Poses there are of the bottom centre; half the height is added. Source: KITTI raw development
    kit, readTracklets.

    Raises:
        InputError: missing, not XML, or a tracklet lacks a field.
    """
    mend = "download it again"
    text = files.read_text(path, TEXT_LIMIT)
    if "<!ENTITY" in text:  # which can multiply; KITTI has none
        raise InputError(path, "XML", "defines entities, which are not supported", mend)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(path, "XML", f"cannot be read ({error})", mend) from None
    tracks = []
    for number, item in enumerate(root.findall("tracklets/item")):
        where = f"tracklet {number}"
        size = np.array([_number(item, key, path, where) for key in ("l", "w", "h")])
        poses = [
            [_number(pose, key, path, where) for key in ("tx", "ty", "tz", "rz")]
            for pose in item.findall("poses/item")
        ]
        first = _number(item, "first_frame", path, where)
        if not poses or not (first.is_integer() and 0 <= first < MOST_FRAMES):
            raise InputError(path, where, f"has {len(poses)} poses from frame {first:g} on", mend)
        values = np.array(poses)
        with refused(path, mend):
            _check_box(where, size, values)
        centre = values[:, :3] + [0.0, 0.0, size[2] / 2]
        tracks.append(
            LabelledTrack(
                track_id=str(number),
                category=_category(item.findtext("objectType", ""), path, where),
                frames=int(first) + np.arange(len(values), dtype=np.int64),
                sensor_from_box=se3.from_rotation_translation(se3.rotation_z(values[:, 3]), centre),
                size=size,
            )
        )
    return tracks


def _number(element: ElementTree.Element, key: str, path: Path, where: str) -> float:
    text = element.findtext(key)
    try:
        value = float(text if text is not None else "")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(
            path, f"{where}.{key}", f"is {text!r}, not a finite number", "download it again"
        )
    return value


def _category(name: str, path: Path, where: str) -> str:
    try:
        return CATEGORIES[name.strip().lower()]
    except KeyError:
        raise InputError(path, where, f"unknown type {name!r}", "name a KITTI label file") from None


def read_labels(path: Path, frame_count: int) -> list[LabelledTrack]:
    """Read tracklet_labels.xml or a tracking label file (any other suffix). Raises InputError:
    missing or malformed, or a frame is beyond the drive's `frame_count`."""
    tracks = read_tracklets(path) if path.suffix == ".xml" else read_tracking_labels(path)
    for track in tracks:
        if track.frames[-1] >= frame_count:
            raise InputError(
                path,
                f"track {track.track_id}",
                f"has frame {track.frames[-1]}, but the drive has {frame_count} frames",
                "name the label file of this drive",
            )
    return tracks


def place_tracks(
    labelled: Sequence[LabelledTrack],
    path: Path,
    turns: tuple[Int64Array, Int64Array, Int64Array],
    calibration: KittiCalibration,
    trajectory: Trajectory,
) -> dict[str, Track]:
    """Tracks by id, as far as the ego trajectory goes.

    Args:
        path: the label file, which tells the frame the boxes are given in.
        turns: trigger, start and end times of all turns of the drive.
    """
    trigger, start, end = turns
    is_tracklets = path.suffix == ".xml"
    rig_from_sensor = (
        calibration.rig_from_velodyne if is_tracklets else calibration.rig_from_rectified
    )
    velodyne_from_rig = se3.inverse(calibration.rig_from_velodyne)
    tracks = {}
    for track in labelled:
        frames = track.frames
        rig_from_box = rig_from_sensor @ track.sensor_from_box
        centres = se3.apply(velodyne_from_rig, rig_from_box[:, :3, 3])
        times = firing_times(centres, trigger[frames], start[frames], end[frames])
        first, last = trajectory.timestamps_us[[0, -1]]
        kept = (first <= times) & (times <= last)
        # Behind the car one turn ends and the next begins: a box there can be met twice at once.
        kept[1:] &= np.diff(times) > 0
        if not np.any(kept):
            continue
        poses = trajectory.at(times[kept]) @ rig_from_box[kept]
        # A labelled frame counts as the whole turn: its image may come before the scanner did.
        turn = max(start[frames[0]], first), min(end[frames[-1]], last)
        boxes = motion.extended(Trajectory(times[kept], poses), *turn)
        tracks[track.track_id] = Track(track.track_id, track.category, track.size, boxes)
    return tracks


def check_labels_fit(log: DrivingLog, tracks: Mapping[str, Track], path: Path) -> None:
    """Check that the boxes near the car hold LiDAR points.

    With fewer than five boxes to judge by, nothing is said.

    Raises:
        InputError: most boxes are empty: the labels belong to another drive.
    """
    times = np.concatenate([lidar.timestamps_us for lidar in log.lidars.values()])
    tested = filled = 0
    for name, points in all_track_points(log, tracks, margin=0.1, clearance=0.25).items():
        near = _near_sweeps(log, tracks[name], times)
        counts = np.bincount(points.sweep, minlength=len(times))
        tested += len(near)
        filled += int(np.count_nonzero(counts[near] >= MIN_POINTS))
    if tested >= MIN_BOXES and filled < MIN_FRACTION * tested:
        raise InputError(
            path,
            "boxes",
            f"{tested - filled} of {tested} boxes within {RANGE:.0f} m hold no LiDAR points: "
            "labels of another drive",
            "name the label file of this drive",
        )


def _near_sweeps(log: DrivingLog, track: Track, times: Int64Array) -> NDArray[np.intp]:
    """Indices of the sweeps in which the object is labelled and near."""
    gaps = np.abs(track.trajectory.timestamps_us[:, None] - times)
    boxes, sweeps = np.nonzero(gaps < SWEEP_US)
    places = track.trajectory.poses[boxes, :2, 3]
    ego = log.world_from_rig.at(times[sweeps])[:, :2, 3]
    return np.unique(sweeps[np.linalg.norm(places - ego, axis=1) < RANGE])


# KITTI raw: one synchronised and rectified drive as a driving log.
#
# Sensors keep their own timestamps, less the delay of the images. Sweeps as recorded are smeared by
# the ego motion of one turn: every point gets the time at which the scanner pointed at it, and the
# motion is undone (docs/data.md has the measurements).

VELODYNE = "velodyne"
GREY = ("image_00", "image_01")
COLOUR = ("image_02", "image_03")
LONGEST_DELAY_US = 100_000  # a turn of the scanner
LICENCE = "CC BY-NC-SA 3.0"


def load_kitti(
    root: Path,
    drive: str,
    labels: Path | None = None,
    cameras: Sequence[str] = (),
    refine: bool = True,
    with_map: bool = True,
) -> DrivingLog:
    """Read a KITTI raw drive; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the day folders ("2011_09_26").
        drive: "2011_09_26_drive_0013", with or without "_sync".
        labels: a KITTI tracking label file (.txt) or tracklet_labels.xml; None for the drive's own
            tracklet_labels.xml, if there is one.
        cameras: image folders to read; if empty, image_02 and image_03, as far as they are there,
            because a scene cannot learn colours from the grey images of image_00 and image_01.
        refine: correct the GPS/IMU poses by matching sweeps; without it, static objects are smeared
            by decimetres.
        with_map: derive a map from the drive (see `derive_map`), which takes seconds.

    Raises:
        InputError: files are missing, broken or do not belong together.
    """
    log = _read(root, drive, labels, cameras, refine)
    if with_map and ego_path(log.world_from_rig) is not None:
        return replace(log, map=derive_map(log))
    return log


@returns_valid
def _read(
    root: Path, drive: str, labels: Path | None, cameras: Sequence[str], refine: bool
) -> DrivingLog:
    """The drive without a map."""
    files = kitti_files.find_drive(Path(root), drive)
    taken = _cameras(files, cameras)
    calibration = read_calibration(files.calibration, taken)
    turns = list_turns(files.folder / "velodyne_points")
    times = turn_times(files.folder / "velodyne_points")
    images = {name: _image_files(files.folder / name, times[0]) for name in taken}
    # What can be found wrong in the files is found before the long work.
    sources = {
        name: _image_source(calibration.cameras[name], listed.paths)
        for name, listed in images.items()
    }
    for source in sources.values():
        source.check()
    own = files.folder / "tracklet_labels.xml"
    chosen = Path(labels) if labels is not None else own if own.is_file() else None
    labelled = [] if chosen is None else read_labels(chosen, len(times[0]))
    covered = (
        min(turns.start_us[0], *(listed.timestamps_us[0] for listed in images.values())),
        max(turns.end_us[-1], *(listed.timestamps_us[-1] for listed in images.values())),
    )
    trajectory, offset = _ego(files, calibration, covered)
    if refine:
        trajectory = refine_trajectory(_lidar(calibration, turns, trajectory), trajectory)
        yaw = heading_offset(trajectory)
        turned = se3.from_rotation_translation(se3.rotation_z(yaw), np.zeros(3))
        trajectory = replace(trajectory, poses=trajectory.poses @ turned)
        calibration = calibration.seen_from(se3.inverse(turned))
    log = DrivingLog(
        name=files.name,
        cameras={
            name: _camera(name, calibration, listed, sources[name], trajectory)
            for name, listed in images.items()
        },
        lidars={VELODYNE: _lidar(calibration, turns, trajectory)},
        world_from_rig=trajectory,
        tracks={},
        world_offset=offset,
        metadata={
            "dataset": "KITTI raw",
            "drive": files.name,
            "licence": LICENCE,
            "poses": "OXTS refined by LiDAR" if refine else "OXTS",
        },
    )
    if chosen is None:
        return log
    tracks = place_tracks(labelled, chosen, times, calibration, trajectory)
    check_labels_fit(log, tracks, chosen)
    return replace(log, tracks=tracks)


def _cameras(files: KittiDrive, named: Sequence[str]) -> tuple[str, ...]:
    """The cameras to take: those named, or else all with colours, or else all."""
    found = [name for name in GREY + COLOUR if (files.folder / name).is_dir()]
    if not found:
        mend = "unpack the drive's images beside its velodyne_points"
        raise InputError(files.folder, "cameras", "image_00 to image_03 are missing", mend)
    coloured = [name for name in found if name in COLOUR]
    return tuple(chosen_cameras(files.folder, found, named or coloured))


def _image_files(folder: Path, trigger_us: Int64Array) -> SensorFiles:
    listed = kitti_files.list_frames(folder, *IMAGES)
    if listed.indices[-1] >= len(trigger_us):
        return listed
    # The scanner triggers the shutter as it faces forward; the images' stamps come about 10 ms
    # later, at the host. Images and sweeps match best (docs/data.md) without that delay.
    delay = int(np.median(listed.timestamps_us - trigger_us[listed.indices]))
    if abs(delay) > LONGEST_DELAY_US:
        problem = f"are {delay / 1e6:.3f} s after the scanner's triggers of the same frames"
        mend = "use sensors of the same drive"
        raise InputError(folder / "timestamps.txt", "times", problem, mend)
    return replace(listed, timestamps_us=listed.timestamps_us - delay)


def _ego(
    files: KittiDrive, calibration: KittiCalibration, covered: tuple[int, int]
) -> tuple[Trajectory, Array]:
    """The ego trajectory (of the rig frame, near the origin) and the offset taken off it."""
    listed = kitti_files.list_frames(files.folder / "oxts", ".txt")
    world_from_imu = poses_from_oxts(read_oxts(listed))
    jump = first_jump(listed.timestamps_us, world_from_imu)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the packet before it"
        raise InputError(listed.paths[jump[0]], "position", problem, "download it again")
    poses = world_from_imu @ se3.inverse(calibration.rig_from_imu)
    offset = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    return motion.extended(Trajectory(listed.timestamps_us, poses), *covered), offset


def _camera(
    name: str,
    calibration: KittiCalibration,
    listed: SensorFiles,
    source: ImageFiles,
    trajectory: Trajectory,
) -> CameraStream:
    kept = [i for i, time in enumerate(listed.timestamps_us) if trajectory.covers(int(time))]
    _require(kept, listed.paths)
    return CameraStream(
        name=name,
        camera=calibration.cameras[name],
        rig_from_camera=calibration.rig_from_camera[name],
        timestamps_us=listed.timestamps_us[kept],
        images=replace(source, paths=tuple(listed.paths[i] for i in kept)),
    )


def _require(kept: Sequence[int], paths: Sequence[Path]) -> None:
    if not kept:
        problem = "no frame lies within the times of the OXTS poses"
        mend = "use sensors and poses of the same drive"
        raise InputError(paths[0].parents[1], "timestamps.txt", problem, mend)


def _image_source(camera: PinholeCamera, paths: tuple[Path, ...]) -> ImageFiles:
    return ImageFiles(paths, camera.width, camera.height, "calib_cam_to_cam.txt")


def _lidar(
    calibration: KittiCalibration, turns: VelodyneTurns, trajectory: Trajectory
) -> LidarStream:
    kept = [
        i
        for i in range(len(turns.paths))
        if trajectory.covers(int(turns.start_us[i])) and trajectory.covers(int(turns.end_us[i]))
    ]
    _require(kept, turns.paths)
    kept_turns = turns.select(kept)
    mount = calibration.rig_from_velodyne
    return LidarStream(
        VELODYNE, mount, kept_turns.trigger_us, VelodyneSweeps(kept_turns, mount, trajectory)
    )
