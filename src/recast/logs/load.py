"""Any driving log by one call, from a folder, object storage or a dataset; and what it holds.

Log folders in object storage are copied once into a local cache, and read from there.

Tracks come in the order in which they are worth replacing, with the evidence for it.
"""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from upath import UPath

from recast.cameras import box_rectangle
from recast.core.arguments import checked
from recast.core.artefact import answering, cache_folder, digest, local_path, remote_path
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import alone_in, atomic_folder, disk_errors, member
from recast.core.foreign import foreign_call
from recast.core.plugins import IMPORTERS
from recast.geometry import se3
from recast.logs.motion import all_track_points
from recast.logs.plausibility import (
    Plausibility,
    examined,
    plausibility,
    require_plausible,
    warn_odd,
)
from recast.logs.store import LOG_FILE, read_log
from recast.logs.types import PEOPLE, VEHICLES, CameraStream, DrivingLog, Track

CopyProgress = Progress
"""Called with the bytes copied so far, and with all there are."""

_BLOCK = 1 << 23
"""Bytes that are copied at a time."""
_VERSIONS = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "mtime", "created")
"""What file systems call that which tells one version of a file from another, the best first."""


@checked()
def load_log(
    source: str | Path | UPath | DrivingLog,
    *,
    importer: str | Callable[..., DrivingLog] | None = None,
    drive: str | None = None,
    labels: str | Path | None = None,
    cameras: Sequence[str] = (),
    progress: CopyProgress | None = None,
    **options: Any,
) -> DrivingLog:
    """Load a driving log; its images and sweeps are decoded when asked for.

    Args:
        source: a log folder; or its address in object storage, such as "s3://bucket/folder" or a
            `UPath`, from where it is copied once (see `recast.logs.load.local_folder`); or the
            dataset's folder, with `importer`; or a log, which is returned as it is.
        importer: name of the dataset's importer, such as "kitti", "package.module:attribute", or a
            `LogImporter`. Nothing is written; see `write_log`.
        drive: the drive's name in the dataset; needed with `importer`, unless it reads a file of
            one drive, as "alpasim" does.
        labels: box labels that lie apart from the drive; only with `importer`.
        cameras: names of the cameras to import; the importer's default if empty; only with
            `importer`.
        progress: called with the bytes copied so far and with all there are.
        options: further ones of the importer, such as `refine` of "kitti".

    Returns:
        a valid log in recast's frames and units, see `DrivingLog`. Its `origin` is the folder it
        was read from, or None if it was imported.

    Raises:
        InputError: no such folder, address, importer, drive or option; the remote does not answer;
            files are missing or broken; or no vehicle can have recorded the log. The line names
            the file and the field.

    Warns:
        OddLogWarning: the log holds what a vehicle hardly does, such as boxes wider than long; see
            `recast.logs.plausibility`.

    >>> sorted(load_log(folder / "log").tracks)
    ['0', '1']
    """
    if importer is not None:
        given = {
            **({} if labels is None else {"labels": Path(labels)}),
            **({"cameras": tuple(cameras)} if cameras else {}),
            **options,
        }
        log = _imported(importer, source, drive, given)
        warn_odd(log)
        return log
    if drive is not None or labels is not None or cameras or options:
        problem = "is missing, but a drive or options of an importer are given"
        raise InputError(
            "load_log", "importer", problem, 'name an importer, such as importer="kitti"'
        )
    if isinstance(source, DrivingLog):
        log = source
        require_plausible(log, f"log {log.name}", "correct the data from which the log was made")
    else:
        log = read_log(local_folder(source, progress))
    warn_odd(log)
    return log


def _imported(
    importer: str | Callable[..., DrivingLog], root: Any, drive: str | None, given: dict[str, Any]
) -> DrivingLog:
    load: Callable[..., DrivingLog] = IMPORTERS.resolve(importer)
    name = importer if isinstance(importer, str) else getattr(importer, "__name__", "object")
    if not isinstance(root, str | os.PathLike) or "://" in os.fspath(root):
        shown = root if isinstance(root, str) else type(root).__name__
        raise InputError("importer", name, f"cannot read {shown}", "name a local folder")
    _check_call(name, load, drive, given)
    with foreign_call(f"importer {name}", os.fspath(root), load):
        log = load(Path(root), **given) if drive is None else load(Path(root), drive, **given)
    if not isinstance(log, DrivingLog):
        problem = f"returned {type(log).__name__} in place of a DrivingLog"
        raise InputError("importer", name, problem, "return the log; write_log writes it")
    return examined(log, Path(root))


def _check_call(
    name: str, load: Callable[..., DrivingLog], drive: str | None, given: Mapping[str, Any]
) -> None:
    """Refuse a missing drive, unless the importer has a default, and options that it lacks."""
    known: Mapping[str, inspect.Parameter] | None = None
    with suppress(TypeError, ValueError):  # made in C
        known = inspect.signature(load).parameters
    default = known["drive"].default if known and "drive" in known else inspect.Parameter.empty
    if drive is None and default is inspect.Parameter.empty:
        raise InputError("importer", name, "needs the name of a drive", "give the `drive`")
    if known is None or any(one.kind is inspect.Parameter.VAR_KEYWORD for one in known.values()):
        return
    for option in given:
        if option not in known:
            raise InputError("importer", name, f"has no option {option}", "leave it out")


def local_folder(address: str | Path | UPath, progress: CopyProgress | None = None) -> Path:
    """The folder of a log on this machine: the folder itself, or a copy of a remote one.

    The files at the address are listed every time. Where the cache has no copy of exactly these
    files (names, sizes, versions), they are copied to `logs/<hash of the address>/<hash of the
    list>` in `cache_folder()`. The copy appears whole or not at all and is never changed, so a log
    that was read from an older copy stays readable. Processes that want the same copy wait for the
    one that makes it.

    Args:
        address: a local path, or what universal-pathlib knows, such as "s3://bucket/folder". A
            `UPath` brings its own storage options.
        progress: called after each block, and once before the first.

    Raises:
        InputError: an unknown kind of address, or its package is missing; the remote does not
            answer, or has no log.json there; a file arrived with another size; the disk refuses.
    """
    remote = remote_path(address)
    if remote is None:
        return local_path(address)
    found = _Remote(str(remote).rstrip("/"), remote.fs, remote.path.rstrip("/"))
    files = found.list_files()
    if LOG_FILE not in files:
        mend = "name a folder that recast log import wrote"
        raise InputError(found.address, LOG_FILE, "is missing", mend)
    listed = json.dumps({name: [one.size, one.version] for name, one in files.items()})
    shelf = cache_folder("logs", digest(found.address))
    copy = shelf / digest(listed)
    with disk_errors(shelf):
        shelf.mkdir(parents=True, exist_ok=True)
    with alone_in(shelf, wait=True):
        if not copy.is_dir():
            with atomic_folder(copy) as folder:
                found.copy(files, folder, progress)
    return copy


@dataclass(frozen=True)
class _File:
    """A remote file: its path there, size in bytes, and version (empty if it has none)."""

    path: str
    size: int
    version: str


@dataclass(frozen=True)
class _Remote:
    """A remote folder: its address for messages, its file system, and its path there."""

    address: str
    system: Any
    path: str

    def list_files(self) -> dict[str, _File]:
        """All files below the folder by relative name, sorted."""
        with answering(self.address, "files"):
            self.system.invalidate_cache()
            found = self.system.find(self.path, detail=True)
        files = {}
        for path, about in found.items():
            if about.get("type", "file") == "file" and path.startswith(self.path + "/"):
                version = next((str(about[key]) for key in _VERSIONS if about.get(key)), "")
                name = PurePosixPath(path.removeprefix(self.path + "/")).as_posix()
                files[name] = _File(path, int(about.get("size") or 0), version)
        return dict(sorted(files.items()))

    def copy(
        self, files: dict[str, _File], folder: Path, progress: CopyProgress | None = None
    ) -> None:
        """Copy the files into a local folder, one at a time; checks their sizes."""
        done, total = 0, sum(file.size for file in files.values())
        if progress is not None:
            progress(done, total)
        for name, file in files.items():
            target = member(folder, name, self.address, "file name")
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as out:
                for block in self._blocks(name, file):
                    out.write(block)
                    done += len(block)
                    if progress is not None:
                        progress(done, total)
                copied = out.tell()
            if copied != file.size:
                problem = f"{copied} bytes arrived, {file.size} were expected"
                raise InputError(self.address, name, problem, "load it again")

    def _blocks(self, name: str, file: _File) -> Iterator[bytes]:
        with answering(self.address, name):
            stream = self.system.open(file.path, "rb")
        with stream:
            while True:
                with answering(self.address, name):
                    block = stream.read(_BLOCK)
                if not block:
                    return
                yield block


SIDES = {"front": (0, 1.0), "left": (1, 1.0), "rear": (0, -1.0), "right": (1, -1.0)}
GRAZING = np.radians(15.0)  # a face seen under a smaller angle shows nothing
NEAR = 1.0  # metres: nearer parts of a box beside the camera would cover half the world
SMALLEST = 64.0  # square pixels of a box inside the image
WHOLE = 0.95  # of it: labels are a little large, the image may cut their edge
SMALLEST_PART = 0.2  # of the box's rectangle inside the image
FEWEST_POINTS = 20  # LiDAR points without which no vehicle is placed
MOVING = 2.0  # metres: labels of parked cars wander by less


@dataclass(frozen=True)
class TrackVisibility:
    """Camera frames in which a track's box is in the image, and which of its faces point there.

    Other objects in the way are not considered.

    Attributes:
        frames: frames with the box in the image, over all cameras.
        front, left, rear, right: frames in which that face is seen under more than 15 degrees.
        crop: width and height in pixels of the largest part of an image that the box covers, among
            the frames that show it whole if there are any.
        whole: whether a frame shows the whole box, not cut by the border of the image.
        span: degrees about the box's vertical axis that the directions to the cameras span.
    """

    frames: int
    front: int
    left: int
    rear: int
    right: int
    crop: tuple[int, int]
    whole: bool = True
    span: float = 0.0

    def sides(self) -> tuple[str, ...]:
        """Names of the faces seen at all."""
        return tuple(side for side in SIDES if getattr(self, side))


@dataclass(frozen=True)
class TrackInfo:
    """One row of `recast log info`; lengths in metres, times in seconds.

    Attributes:
        seconds: time from the first to the last label.
        displacement: diagonal of the axis-aligned box around all its places.
        lidar_points: LiDAR points in the box over all sweeps.
        usable: whether a camera and the LiDAR saw it well enough to replace it, and its category is
            one that can be replaced. Boxes that no car or person has are refused later.
        why: the evidence in words, or what is missing.
    """

    track_id: str
    category: str
    size: tuple[float, float, float]
    seconds: float
    displacement: float
    lidar_points: int
    visibility: TrackVisibility
    usable: bool = False
    why: str = ""

    @property
    def evidence(self) -> int:
        """Key of the ranking: frames times the crop's longer side times LiDAR points."""
        return self.visibility.frames * max(self.visibility.crop) * self.lidar_points


@dataclass(frozen=True)
class SensorInfo:
    """One sensor: kind "camera" or "lidar", frames recorded, frames a second."""

    name: str
    kind: str
    frames: int
    rate: float
    width: int | None = None
    height: int | None = None


@dataclass(frozen=True)
class LogInfo:
    """Everything that `recast log info` prints.

    Attributes:
        seconds: duration of the ego trajectory.
        ego_distance: metres driven.
        tracks: the best candidates for replacing first.
        map_kind: "none", "derived" or "surveyed".
        plausibility: whether a vehicle can have recorded it, with what was measured.
    """

    name: str
    seconds: float
    ego_distance: float
    sensors: tuple[SensorInfo, ...]
    tracks: tuple[TrackInfo, ...]
    map_kind: str
    lanes: int
    metadata: dict[str, str]
    plausibility: Plausibility


def log_info(log: DrivingLog) -> LogInfo:
    """Summarise a log; reads every sweep once, and some images."""
    points = all_track_points(log, log.tracks)
    places = log.world_from_rig.poses[:, :3, 3]
    sensors = [
        SensorInfo(
            name,
            "camera",
            len(camera.timestamps_us),
            _rate(camera.timestamps_us),
            camera.camera.width,
            camera.camera.height,
        )
        for name, camera in log.cameras.items()
    ]
    sensors += [
        SensorInfo(name, "lidar", len(lidar.timestamps_us), _rate(lidar.timestamps_us))
        for name, lidar in log.lidars.items()
    ]
    tracks = [
        TrackInfo(
            track_id=name,
            category=track.category,
            size=(float(track.size[0]), float(track.size[1]), float(track.size[2])),
            seconds=float(np.ptp(track.trajectory.timestamps_us)) / 1e6,
            displacement=float(np.linalg.norm(np.ptp(track.trajectory.poses[:, :3, 3], axis=0))),
            lidar_points=len(points[name].points),
            visibility=track_visibility(log, track),
        )
        for name, track in log.tracks.items()
    ]
    return LogInfo(
        name=log.name,
        seconds=float(np.ptp(log.world_from_rig.timestamps_us)) / 1e6,
        ego_distance=float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()),
        sensors=tuple(sensors),
        tracks=ranked(tracks),
        map_kind="none" if log.map is None else "derived" if log.map.derived else "surveyed",
        lanes=0 if log.map is None else len(log.map.lanes),
        metadata=dict(log.metadata),
        plausibility=plausibility(log),
    )


def ranked(tracks: Sequence[TrackInfo]) -> tuple[TrackInfo, ...]:
    """The tracks with `usable` and `why`, the best candidates for replacing first.

    Those that can be replaced come first, vehicles before people, then the rest; within each by
    `TrackInfo.evidence`, and by LiDAR points where there is none.
    """
    rated = [_rated(track) for track in tracks]
    rated.sort(
        key=lambda t: (t.usable, t.category in VEHICLES, t.evidence, t.lidar_points), reverse=True
    )
    return tuple(rated)


def _rated(track: TrackInfo) -> TrackInfo:
    seen, points = track.visibility, track.lidar_points
    if track.category not in (*VEHICLES, *PEOPLE):
        return replace(track, why="is not a car, van, truck, bus, pedestrian or cyclist")
    if seen.frames == 0:
        return replace(track, why="is not visible in any image")
    if not seen.whole:
        return replace(track, why="is cut by the image border in every image")
    if points < FEWEST_POINTS:
        return replace(track, why=f"has {points} LiDAR points, {FEWEST_POINTS} are needed")
    moves = "moves" if track.displacement > MOVING else "stands"
    unseen = [side for side in SIDES if side not in seen.sides()]
    why = (
        f"{moves}; {seen.frames} frames, up to {seen.crop[0]} x {seen.crop[1]} px; "
        f"{points:,} LiDAR points; {', '.join(unseen) or 'no side'} never seen; "
        f"views span {seen.span:.0f} degrees"
    )
    return replace(track, usable=True, why=why)


def _rate(timestamps_us: np.ndarray) -> float:
    if len(timestamps_us) < 2:
        return 0.0
    return float(1e6 / np.median(np.diff(timestamps_us)))


def track_visibility(log: DrivingLog, track: Track) -> TrackVisibility:
    """Count the camera frames that show a track, and its faces in them."""
    counts = dict.fromkeys(SIDES, 0)
    frames = 0
    largest, is_whole = (0, 0), False
    azimuths = []
    for camera in log.cameras.values():
        for time in camera.timestamps_us.tolist():
            if not track.trajectory.covers(time):
                continue
            world_from_camera = log.world_from_rig.at(time) @ camera.rig_from_camera
            camera_from_box = se3.inverse(world_from_camera) @ track.trajectory.at(time)
            seen = crop_in_image(camera, track, camera_from_box)
            if seen is None:
                continue
            frames += 1
            crop, share = seen
            whole = share >= WHOLE
            if (whole, max(crop)) > (is_whole, max(largest)):
                largest, is_whole = crop, whole
            eye = se3.inverse(camera_from_box)[:3, 3]
            azimuths.append(float(np.degrees(np.arctan2(eye[1], eye[0]))))
            for side, (axis, sign) in SIDES.items():
                towards = eye.copy()
                towards[axis] -= sign * track.size[axis] / 2
                sine = sign * towards[axis] / max(float(np.linalg.norm(towards)), 1e-9)
                counts[side] += bool(sine > np.sin(GRAZING))
    span = arc(azimuths)[1] if azimuths else 0.0
    return TrackVisibility(frames=frames, **counts, crop=largest, whole=is_whole, span=span)


def arc(degrees: Sequence[float]) -> tuple[float, float]:
    """The shortest arc that holds directions: where it begins, counter-clockwise, and its length,
    degrees."""
    around = np.sort(np.asarray(degrees) % 360.0)
    gaps = np.diff(around, append=around[0] + 360.0)
    widest = int(gaps.argmax())
    return float(around[(widest + 1) % len(around)]), float(360.0 - gaps[widest])


def crop_in_image(
    camera: CameraStream, track: Track, camera_from_box: np.ndarray
) -> tuple[tuple[int, int], float] | None:
    """Width and height in pixels of what a box at (4, 4) `camera_from_box` covers of the image, and
    the share of the box's rectangle that this is.

    None unless a fair part of it lies inside.
    """
    rectangle = box_rectangle(track.size, camera_from_box, camera.camera, near=NEAR)
    if rectangle is None:
        return None
    limits = np.array([camera.camera.width, camera.camera.height], np.float64)
    inside = np.clip(rectangle[2:], 0, limits) - np.clip(rectangle[:2], 0, limits)
    whole = float(np.prod(rectangle[2:] - rectangle[:2]))
    if float(np.prod(inside)) < max(SMALLEST, SMALLEST_PART * whole):
        return None
    share = float(np.prod(inside)) / whole
    return (round(float(inside[0])), round(float(inside[1]))), share
