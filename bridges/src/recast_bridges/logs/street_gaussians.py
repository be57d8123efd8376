"""Street Gaussians' processed Waymo scenes: poses, boxes, points and images as a driving log.

Source: Yan et al., "Street Gaussians: Modeling Dynamic Urban Scenes with Gaussian Splatting" (ECCV
2024), and the layout that its preprocessing writes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.core.files import read_text
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.common import chosen_cameras, returns_valid
from recast.logs.importers.waymo_proto import LICENCE
from recast.logs.types import Array, CameraStream, DrivingLog, Track, Trajectory
from recast_bridges.logs.processed_folder import FARTHEST, CameraFolder, find_scene, read_cameras
from recast_bridges.logs.street_gaussians_frames import TrainedFrames, read_drive, read_lidar

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
    """One line.

    Attributes:
        where: the line, for messages.
        frame: number of the frame.
        track: track number, as written.
        kind: class in lower case, whatever it is.
        size: (3,) length, width, height in metres, not checked.
        centre: (3,) metres, vehicle frame at the frame's time.
        heading: radians, counter-clockwise from the vehicle's x axis.
    """

    where: str
    frame: int
    track: str
    kind: str
    size: Array
    centre: Array
    heading: float


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
    """Tracks by the file's own numbers, each box placed with its frame's vehicle pose.

    Raises:
        InputError: the file is missing, a line has too few or wrong values, an unknown class or
            frame, a box comes twice, or is not in the vehicle's frame.
    """
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
