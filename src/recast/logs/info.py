"""What a log holds: sensors, duration, and of every track how long, how far and from where seen.

Tracks come in the order in which they are worth replacing, with the evidence for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from recast.cameras import box_rectangle
from recast.geometry import se3
from recast.logs.motion import all_track_points
from recast.logs.plausibility import Plausibility, plausibility
from recast.logs.types import VEHICLES, CameraStream, DrivingLog, Track

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
    """

    frames: int
    front: int
    left: int
    rear: int
    right: int
    crop: tuple[int, int]
    whole: bool = True

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
        usable: whether it is a vehicle that a camera and the LiDAR saw well enough to replace it.
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

    Those that can be replaced come first, then other vehicles, then the rest; within each by
    `TrackInfo.evidence`, and by LiDAR points where there is none.
    """
    rated = [_rated(track) for track in tracks]
    rated.sort(
        key=lambda t: (t.usable, t.category in VEHICLES, t.evidence, t.lidar_points), reverse=True
    )
    return tuple(rated)


def _rated(track: TrackInfo) -> TrackInfo:
    seen, points = track.visibility, track.lidar_points
    if track.category not in VEHICLES:
        return replace(track, why="is not a car, van, truck or bus")
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
        f"{points:,} LiDAR points; {', '.join(unseen) or 'no side'} never seen"
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
            for side, (axis, sign) in SIDES.items():
                towards = eye.copy()
                towards[axis] -= sign * track.size[axis] / 2
                sine = sign * towards[axis] / max(float(np.linalg.norm(towards)), 1e-9)
                counts[side] += bool(sine > np.sin(GRAZING))
    return TrackVisibility(frames=frames, **counts, crop=largest, whole=is_whole)


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
