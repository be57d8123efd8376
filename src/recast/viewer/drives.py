"""Drives of a log, a scene, an actor and a rollout, and their pictures by step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import islice
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.dynamics import PACIFICA
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, HdMap, Trajectory
from recast.logs.hdmap import drivable_region
from recast.metrics.collision import any_collision
from recast.metrics.rollout_metrics import rollout_collisions
from recast.metrics.route import drivable_area_compliance
from recast.reporting.video import iterate_video
from recast.scene import SceneActor, StreetScene
from recast.simulation import Rollout
from recast.viewer.inputs import CameraImages, MountedCamera, ViewedDrive, ViewerEvent

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
        log: log that it was run on.
        hdmap: map of the log, for where the ego leaves the road; or None.
        mounts: cameras on the rig.
        films: what was rendered, by name of the camera.
    """
    steps = range(rollout.steps_run + 1)
    times = np.array([rollout.timestamp_us(step) for step in steps])
    logged = {key: log.tracks[key] for key in rollout.other_actors if key in log.tracks}
    poses = {key: sampled(track.trajectory, times) for key, track in logged.items()}
    sizes = {key: track.size for key, track in logged.items()}
    poses[rollout.track_id], sizes[rollout.track_id] = rollout.world_from_actor, rollout.actor_size
    for one in rollout.controlled:
        poses[one.track_id], sizes[one.track_id] = one.world_from_actor, one.size
    return ViewedDrive(
        dt=rollout.dt,
        times_us=times,
        rig=rollout.world_from_rig,
        poses=poses,
        sizes=sizes,
        controlled=(rollout.track_id, *(one.track_id for one in rollout.controlled)),
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
