"""What the viewer shows: scenes, how everything moves in them, and images taken on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors import Actor
from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.diagnostics import Progress
from recast.dynamics import PACIFICA
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, HdMap, Trajectory
from recast.logs.hdmap import drivable_region
from recast.metrics.driving import any_collision, drivable_area_compliance
from recast.metrics.rollout_metrics import rollout_collisions
from recast.reporting.video import iterate_video
from recast.scene import SceneActor, StreetScene
from recast.simulation import Rollout, ScriptedMotion


class CameraImages(Protocol):
    """Pictures of one camera, by step of a drive."""

    def __len__(self) -> int:
        """Number of steps that have a picture."""

    def __getitem__(self, step: int, /) -> Image:
        """The picture (H, W, 3) RGB of a step."""


@dataclass(frozen=True)
class MountedCamera:
    """A camera on the rig.

    Attributes:
        rig_from_camera: (4, 4) OpenCV camera frame to rig.
        fov: vertical field of view, radians.
        aspect: width over height.
        film: its pictures; None if there are none.
    """

    rig_from_camera: Array
    fov: float
    aspect: float
    film: CameraImages | None = None


@dataclass(frozen=True)
class ViewerEvent:
    """A moment worth going to: what happened, and at which step."""

    label: str
    step: int


@dataclass(frozen=True)
class ViewedDrive:
    """How the ego and all others move, in T steps.

    Attributes:
        dt: seconds between steps.
        times_us: (T,) int64 log time of each step.
        rig: (T, 4, 4) `world_from_rig`; None if there is no ego.
        poses: `world_from_actor` (T, 4, 4) by track id; NaN where the track is absent.
        sizes: (3,) length, width, height by track id, metres.
        controlled: ids of the tracks that a motion controls, the target first.
        ego_size: (3,) size of the ego's box, metres.
        ego_offset: metres from the rig's origin forward to the centre of the ego's box.
        logged: (T, 3) where the ego was in the log; None if that is `rig`.
        plans: (step, waypoints (P, 3) in the world) of each plan, in order.
        events: moments to go to, in order.
    """

    dt: float
    times_us: NDArray[np.int64]
    rig: Array | None
    poses: Mapping[str, Array]
    sizes: Mapping[str, Array]
    controlled: tuple[str, ...] = ()
    ego_size: Array = field(default_factory=lambda: np.array([4.6, 1.9, 1.6]))
    ego_offset: float = 1.4
    logged: Array | None = None
    plans: tuple[tuple[int, Array], ...] = ()
    events: tuple[ViewerEvent, ...] = ()
    cameras: Mapping[str, MountedCamera] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times_us)

    def at(self, step: int) -> dict[str, Array]:
        """Poses (4, 4) of the tracks that are present at a step."""
        present = ((key, poses[step]) for key, poses in self.poses.items())
        return {key: pose for key, pose in present if not np.isnan(pose[0, 0])}


@dataclass(frozen=True)
class Runner:
    """Runs rollouts for the page.

    Attributes:
        hdmap: lanes, drivable area and ground.
        track: the actor to control.
        planners: names of the planners to choose from; the first is the default.
        steps: largest number of steps of 0.1 s.
        run: function that runs a motion with a planner in an arm, and gives the drive; reports its
            steps.
    """

    log: DrivingLog
    hdmap: HdMap
    track: str
    motions: Mapping[str, ScriptedMotion]
    planners: tuple[str, ...]
    steps: int
    run: Callable[[ScriptedMotion, str, str, Progress], ViewedDrive]


@dataclass(frozen=True)
class ViewInputs:
    """Everything that the viewer shows.

    Attributes:
        scenes: the street of each arm with its actors in it; None for an arm without Gaussians.
        scenarios: drives by scenario and arm.
        log: the recorded drive, for images, LiDAR and evidence; None if there is none.
        hdmap: lanes and drivable area, or None.
        actors: generated vehicles by arm and track id, for their coverage.
        runner: runs rollouts from the page, or None.
        renew: function that gives what there is by now, or None if nothing has changed; None if
            nothing can change.
    """

    title: str
    scenes: Mapping[str, StreetScene | None]
    scenarios: Mapping[str, Mapping[str, ViewedDrive]]
    log: DrivingLog | None = None
    hdmap: HdMap | None = None
    actors: Mapping[str, Mapping[str, Actor]] = field(default_factory=dict)
    runner: Runner | None = None
    renew: Callable[[], ViewInputs | None] | None = None

    @property
    def drives(self) -> list[ViewedDrive]:
        """All drives, scenario by scenario."""
        return [drive for arms in self.scenarios.values() for drive in arms.values()]


WIDEST = 480
"""Pixels; larger pictures are scaled down before they are sent."""
_QUALITY = 85
DT = 0.1
"""Seconds between the steps of a recording."""
_EGO_HEIGHT = 1.6  # metres; a log does not say
_ABOVE_ROAD = 0.3  # metres, at which paths are drawn


def mounted(
    camera: PinholeCamera, rig_from_camera: Array, film: CameraImages | None = None
) -> MountedCamera:
    """A camera on the rig with what it saw."""
    fov = 2 * math.atan(camera.height / 2 / camera.fy)
    aspect = camera.width / camera.fx * camera.fy / camera.height
    return MountedCamera(rig_from_camera, fov, aspect, film)


def recording(log: DrivingLog) -> ViewedDrive:
    """The drive as recorded, with all tracks and the images of all cameras."""
    first, last = (int(time) for time in log.world_from_rig.timestamps_us[[0, -1]])
    times = np.arange(first, last + 1, round(DT * 1e6))
    cameras = {
        name: mounted(stream.camera, stream.rig_from_camera, LogFilm(stream, times))
        for name, stream in log.cameras.items()
    }
    return ViewedDrive(
        dt=DT,
        times_us=times,
        rig=log.world_from_rig.at(times),
        poses={key: sampled(track.trajectory, times) for key, track in log.tracks.items()},
        sizes={key: track.size for key, track in log.tracks.items()},
        ego_size=_ego_size(PACIFICA.length, PACIFICA.width),
        ego_offset=PACIFICA.centre_offset,
        cameras=cameras,
    )


def scene_drive(scene: StreetScene) -> ViewedDrive:
    """The actors of a scene on their recorded ways, without an ego."""
    ends = [actor.trajectory.timestamps_us[[0, -1]] for actor in scene.actors.values()]
    first = min((int(end[0]) for end in ends), default=0)
    last = max((int(end[1]) for end in ends), default=0)
    times = np.arange(first, last + 1, round(DT * 1e6))
    return ViewedDrive(
        dt=DT,
        times_us=times,
        rig=None,
        poses={key: sampled(one.trajectory, times) for key, one in scene.actors.items()},
        sizes={key: one.size for key, one in scene.actors.items()},
    )


def still(actor: SceneActor) -> ViewedDrive:
    """One actor standing at the origin, its wheels on z = 0."""
    pose = np.eye(4)
    pose[2, 3] = actor.size[2] / 2
    return ViewedDrive(
        dt=DT,
        times_us=np.zeros(1, np.int64),
        rig=None,
        poses={actor.track_id: pose[None]},
        sizes={actor.track_id: actor.size},
        controlled=(actor.track_id,),
    )


def rollout_drive(
    rollout: Rollout,
    log: DrivingLog,
    hdmap: HdMap | None,
    mounts: Mapping[str, CameraMount],
    films: Mapping[str, CameraImages],
) -> ViewedDrive:
    """A rollout with its plans and the moments that matter.

    Args:
        hdmap: map of the log, for where the ego leaves the road; or None.
        mounts: cameras on the rig.
        films: what was rendered, by name of the camera.
    """
    steps = range(rollout.steps_run + 1)
    times = np.array([rollout.timestamp_us(step) for step in steps])
    poses = {rollout.track_id: rollout.world_from_actor}
    sizes = {rollout.track_id: rollout.actor_size}
    for one in rollout.controlled:
        poses[one.track_id], sizes[one.track_id] = one.world_from_actor, one.size
    return ViewedDrive(
        dt=rollout.dt,
        times_us=times,
        rig=rollout.world_from_rig,
        poses=poses,
        sizes=sizes,
        controlled=tuple(key for key in poses if key not in rollout.other_actors),
        ego_size=_ego_size(*rollout.ego_size),
        ego_offset=rollout.ego_centre_offset,
        logged=np.column_stack(
            [rollout.log_ego[:, :2], rollout.world_from_rig[:, 2, 3] + _ABOVE_ROAD]
        ),
        plans=plan_lines(rollout),
        events=rollout_events(rollout, hdmap),
        cameras={
            name: mounted(mount.camera, mount.rig_from_camera, films.get(name))
            for name, mount in mounts.items()
        },
    )


def plan_lines(rollout: Rollout) -> tuple[tuple[int, Array], ...]:
    """Step and waypoints (41, 3) in the world of each plan, the ego's own place first."""
    lines = []
    for step, plan in zip(rollout.plan_steps.tolist(), rollout.predictions, strict=True):
        flat = np.zeros((len(plan) + 1, 3))
        flat[1:, :2] = plan[:, :2]
        flat[:, 2] = _ABOVE_ROAD
        lines.append((step, se3.apply(rollout.world_from_rig[step], flat)))
    return tuple(lines)


def rollout_events(rollout: Rollout, hdmap: HdMap | None) -> tuple[ViewerEvent, ...]:
    """Contact, departure from the road, each plan, and the end; in order of time."""
    found = [ViewerEvent("start", 0)]
    contact = any_collision(list(rollout_collisions(rollout).values())).first_step
    if contact is not None:
        found.append(ViewerEvent("contact", contact))
    departure = drivable_area_compliance(
        rollout.ego_boxes, rollout.ego_size, drivable_region(hdmap), rollout.dt
    ).first_step
    if departure is not None:
        found.append(ViewerEvent("off the road", departure))
    found += [
        ViewerEvent(f"plan {number}", step)
        for number, step in enumerate(rollout.plan_steps.tolist(), start=1)
    ]
    ending = "end" if rollout.cut_reason is None else f"end: {rollout.cut_reason}"
    found.append(ViewerEvent(ending, rollout.steps_run))
    return tuple(sorted(found, key=lambda event: event.step))


def sampled(trajectory: Trajectory, times_us: NDArray[np.int64]) -> Array:
    """Poses (T, 4, 4) at times (T,); NaN where the trajectory does not cover them."""
    first, last = trajectory.timestamps_us[[0, -1]]
    inside = (times_us >= first) & (times_us <= last)
    poses = np.full((len(times_us), 4, 4), np.nan)
    if inside.any():
        poses[inside] = trajectory.at(times_us[inside])
    return poses


def _ego_size(length: float, width: float) -> Array:
    return np.array([length, width, _EGO_HEIGHT])


class LogFilm:
    """The images of a log's camera nearest in time to the steps of a drive.

    Args:
        times_us: (T,) log time of each step.
    """

    def __init__(self, stream: CameraStream, times_us: NDArray[np.int64]) -> None:
        away = np.abs(stream.timestamps_us[None] - times_us[:, None])
        self._stream, self._frames = stream, away.argmin(axis=1)
        self._picture = lru_cache(maxsize=4)(self._read)  # several tabs and panes ask for one step

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, step: int, /) -> Image:
        return self._picture(int(self._frames[step]))

    def _read(self, frame: int) -> Image:
        return shrunk(self._stream.images[frame])


class FilmFrames:
    """Pictures of a rollout that was run from the page, kept as JPEG."""

    def __init__(self) -> None:
        self._kept: list[NDArray[np.uint8]] = []

    def __len__(self) -> int:
        return len(self._kept)

    def __getitem__(self, step: int, /) -> Image:
        found = cv2.imdecode(self._kept[min(step, len(self._kept) - 1)], cv2.IMREAD_COLOR)
        assert found is not None  # it was encoded here
        return np.asarray(found[..., ::-1], np.uint8)

    def add(self, picture: Image) -> None:
        """Append the picture (H, W, 3) RGB of the next step, at most `WIDEST` wide."""
        options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        kept = cv2.imencode(".jpg", shrunk(picture)[..., ::-1], options)[1]
        self._kept.append(np.asarray(kept, np.uint8))


class FilmFile(FilmFrames):
    """The film of a rollout, decoded as far as it is looked at and kept as JPEG.

    Args:
        path: film that `recast.reporting.video` can read.
        steps: number of pictures that it has; more are not read.
    """

    def __init__(self, path: Path, steps: int) -> None:
        super().__init__()
        self._left, self._steps = iterate_video(path), steps
        self._lock = Lock()

    def __len__(self) -> int:
        return self._steps

    def __getitem__(self, step: int, /) -> Image:
        with self._lock:
            for picture in islice(self._left, max(step + 1 - len(self._kept), 0)):
                self.add(picture)
        return super().__getitem__(step)


def shrunk(picture: Image) -> Image:
    """A picture (H, W, 3), scaled down to `WIDEST` pixels if it is wider."""
    height, width = picture.shape[:2]
    if width <= WIDEST:
        return picture
    size = WIDEST, max(1, round(height * WIDEST / width))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
