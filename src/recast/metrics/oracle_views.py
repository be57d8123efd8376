"""Baseline and candidate actors against the truth, seen from where the log never was.

Views are those that a closed loop needs, all around the vehicle; each knows how far it is from the
nearest logged view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage

from recast.actors.actor import CoverageMeter, Shares
from recast.actors.observation import score_frame
from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import atomic_folder, write_json
from recast.dynamics import PACIFICA
from recast.geometry import boxes, se2, se3
from recast.logs import DrivingLog, Track
from recast.metrics.oracle_scores import (
    RECORD_FILE,
    Agreement,
    OracleView,
    OracleViews,
    actor_mask,
    agreement,
    box_pixels,
    grown,
    summarise,
)
from recast.planning import ReferenceRoute
from recast.reconstruction.scores import Rectangle
from recast.scene import SceneRasterizer, StreetScene
from recast.scene.street_scene import moves
from recast.simulation.recorded_road import RoadSurface

_CLEARANCE = 1.0
"""Metres between the ego's front bumper and the vehicle, however it is turned."""
MAX_DISTANCE = 60.0
"""Metres beyond which a camera tells nothing of a vehicle's sides."""
MIN_SIZE_PX = 16.0
"""Geometric mean of the sides of the box's rectangle, in pixels of the logged image."""
MIN_SEEN = 0.25
"""Share of the box that must lie in the image, and that no other labelled box may hide."""


@dataclass(frozen=True)
class ViewSettings:
    """Which views are compared.

    Attributes:
        moments: logged frames to stand at, spread over those with enough road ahead.
        distances: metres along the road from the camera to the vehicle's box centre; raised where
            the vehicle would touch the ego.
        headings: number of headings, regular over the circle. The first is half a step off the
            road's heading: no view is exactly along an axis of the vehicle.
        camera: name of the camera, or None for the one that looks most nearly straight ahead.
    """

    moments: int = 3
    distances: tuple[float, ...] = (12.0,)
    headings: int = 12
    camera: str | None = None

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        if self.moments < 1 or self.headings < 1:
            raise ValueError("ViewSettings.moments, headings: must be at least 1")
        if not self.distances or min(self.distances) <= 0:
            raise ValueError(
                f"ViewSettings.distances: must be positive metres, got {self.distances}"
            )


@dataclass(frozen=True)
class PlacedView:
    """One view to draw.

    Attributes:
        camera, frame, timestamp_us: the logged frame whose camera pose is used.
        distance: metres along the road from the camera to the vehicle's box centre.
        heading: radians in [-pi, pi) against the road's: 0 drives ahead of the ego, pi faces it.
        world_from_camera, world_from_actor: (4, 4).
    """

    camera: str
    frame: int
    timestamp_us: int
    distance: float
    heading: float
    world_from_camera: Array
    world_from_actor: Array


def place_views(
    log: DrivingLog, track: Track, mounts: Mapping[str, CameraMount], settings: ViewSettings
) -> list[PlacedView]:
    """Place the vehicle on the logged path before the logged ego.

    Views in which it would stand in a parked vehicle are left out.

    Args:
        mounts: cameras as they are rendered.

    Raises:
        InputError: no camera, or none of that name; no logged frame with enough road ahead.
    """
    settings.validate()
    name = _camera(log, mounts, settings.camera)
    mount = mounts[name]
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    ground = None if log.map is None else log.map.ground
    surface = RoadSurface.from_log(log.world_from_rig, route, ground)
    radius = float(np.hypot(*track.size[:2])) / 2
    forward = float(mount.rig_from_camera[0, 3])
    least = PACIFICA.front_length - forward + _CLEARANCE + radius
    distances = tuple(dict.fromkeys(max(d, least) for d in settings.distances))

    views = []
    for frame in _frames(log, name, route, forward + max(distances) + radius, settings.moments):
        time = int(log.cameras[name].timestamps_us[frame])
        rig = log.world_from_rig.at(time)
        here = float(route.project(rig[:2, 3])[0]) + forward
        for distance in distances:
            place = route.pose(here + distance)
            for k in range(settings.headings):
                turn = float(se2.wrap_angle(2 * np.pi * (k + 0.5) / settings.headings))
                pose = np.array([place[0], place[1], place[2] + turn])
                if _stands_in_another(log, track, pose):
                    continue
                views.append(
                    PlacedView(
                        camera=name,
                        frame=frame,
                        timestamp_us=time,
                        distance=distance,
                        heading=turn,
                        world_from_camera=rig @ mount.rig_from_camera,
                        world_from_actor=surface.actor_poses(pose[None], track.size)[0],
                    )
                )
    return views


def _camera(log: DrivingLog, mounts: Mapping[str, CameraMount], wanted: str | None) -> str:
    names = [name for name in mounts if name in log.cameras]
    if wanted is not None and wanted not in names:
        raise InputError(
            log.name, f"camera {wanted}", "is not rendered", f"choose one of {', '.join(names)}"
        )
    if not names:
        raise InputError(
            log.name, "cameras", "none of them is rendered", "render a camera of the log"
        )
    return wanted or max(names, key=lambda name: float(mounts[name].rig_from_camera[0, 2]))


def _frames(
    log: DrivingLog, camera: str, route: ReferenceRoute, ahead: float, count: int
) -> Sequence[int]:
    """Frames spread over those with `ahead` metres of recorded road before the rear axle."""
    times = log.cameras[camera].timestamps_us
    positions = log.world_from_rig.at(times)[:, :2, 3]
    usable = np.flatnonzero(route.project(positions)[0] + ahead <= route.length)
    if len(usable) == 0:
        raise InputError(
            log.name,
            f"camera {camera}",
            f"no frame has {ahead:.0f} m of recorded road ahead ({route.length:.0f} m in all)",
            "give shorter distances, or use a longer log",
        )
    count = min(count, len(usable))
    return [int(usable[int((i + 0.5) / count * len(usable))]) for i in range(count)]


def _stands_in_another(log: DrivingLog, track: Track, pose: Array) -> bool:
    """Whether the vehicle at a planar pose (3,) overlaps one that never moves."""
    for other in log.tracks.values():
        if other.track_id == track.track_id or moves(other.trajectory):
            continue
        standing = se2.from_se3(other.trajectory.poses[0])
        if boxes.bev_overlap_area(pose, track.size, standing, other.size) > 0:
            return True
    return False


def view_direction(world_from_actor: Array, world_from_camera: Array) -> Array:
    """Unit vector (3,) from a vehicle's box centre to a camera, in the actor frame."""
    eye: Array = se3.apply(se3.inverse(world_from_actor), world_from_camera[None, :3, 3])[0]
    return eye / np.linalg.norm(eye)


def logged_views(log: DrivingLog, track: Track) -> Array:
    """Directions (N, 3), actor to camera in the actor frame, of the images that show a vehicle.

    An image counts where the projected box is at least 16 px in size, within 60 m, and at least a
    quarter of it is in the image and not behind other labelled boxes. This is generous: a view
    that is far from all of these is one that the log does not have.
    """
    directions = []
    for stream in log.cameras.values():
        for frame in range(len(stream.timestamps_us)):
            score = score_frame(log, track, stream, frame)
            if score is None or score.size_px < MIN_SIZE_PX:
                continue
            if min(score.in_image, score.unoccluded) < MIN_SEEN:
                continue
            time = score.timestamp_us
            world_from_actor = track.trajectory.at(time)
            world_from_camera = log.world_from_rig.at(time) @ stream.rig_from_camera
            if np.linalg.norm((world_from_camera - world_from_actor)[:3, 3]) <= MAX_DISTANCE:
                directions.append(view_direction(world_from_actor, world_from_camera))
    return np.array(directions).reshape(-1, 3)


def angle_to_nearest(direction: Array, logged: Array) -> float:
    """Degrees from a unit direction (3,) to the nearest of `logged` (N, 3), N >= 1."""
    nearest = logged[np.argmax(logged @ direction)]
    # atan2 rather than arccos: exact where the directions are alike
    cross = np.linalg.norm(np.cross(direction, nearest))
    return float(np.degrees(np.arctan2(cross, direction @ nearest)))


def azimuth_elevation(direction: Array) -> tuple[float, float]:
    """Degrees: azimuth 0 ahead of the vehicle and 90 to its left; elevation above its horizon."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(np.clip(z, -1, 1))))


_MARGIN = 24  # pixels around the box that are ray-traced too: more than half an SSIM window
_OF_PLACE = ("camera", "frame", "timestamp_us", "distance", "heading")
_GAP = 4  # white pixels between pictures


class OracleFrame(Protocol):
    """The truth's picture: (H, W, 3) uint8 RGB, and (H, W) which object each pixel shows."""

    @property
    def rgb(self) -> Image:
        """(H, W, 3) uint8."""

    @property
    def instance(self) -> NDArray[np.uint16]:
        """(H, W)."""


class TrueWorld(Protocol):
    """A world that can be looked at from anywhere."""

    def render(
        self,
        camera: PinholeCamera,
        world_from_camera: Array,
        poses: Mapping[str, Array],
        timestamp_us: int,
        exposure: float,
    ) -> OracleFrame:
        """The street, and the vehicles of `poses` (`world_from_actor` (4, 4) by track id)."""

    def instance_of(self, track_id: str) -> int:
        """The value of `OracleFrame.instance` where it shows this vehicle."""


class Painter:
    """Draws a view with both actors and by the oracle.

    Args:
        size: (3,) length, width, height of the vehicle's box, metres.
        mounts: cameras as they are rendered.
        exposures: exposures of the truth's images, by camera; 1 where one is missing.

    Raises:
        InputError: a scene has no model of the track.
    """

    def __init__(
        self,
        scenes: Mapping[str, StreetScene],
        oracle: TrueWorld,
        track_id: str,
        size: Array,
        mounts: Mapping[str, CameraMount],
        exposures: Mapping[str, float],
    ) -> None:
        for arm, scene in scenes.items():
            if track_id not in scene.actors:
                raise InputError(
                    f"{arm} scene",
                    f"track {track_id}",
                    "has no model",
                    "train the scene with the track in force_dynamic",
                )
        self._actors = {arm: scene.actors[track_id] for arm, scene in scenes.items()}
        self._rasterizers = {arm: SceneRasterizer(scene) for arm, scene in scenes.items()}
        self._oracle, self._track_id, self._size = oracle, track_id, size
        self._mounts, self._exposures = mounts, exposures

    def rectangle(self, view: PlacedView) -> Rectangle | None:
        """Where the vehicle's box is in the image; see `box_pixels`."""
        camera_from_actor = se3.inverse(view.world_from_camera) @ view.world_from_actor
        return box_pixels(self._size, camera_from_actor, self._mounts[view.camera].camera)

    def compare(self, view: PlacedView, rectangle: Rectangle) -> tuple[dict[str, Agreement], Image]:
        """Scores by arm, and the pictures of the box side by side."""
        camera = self._mounts[view.camera].camera
        left, top, right, bottom = grown(rectangle, _MARGIN, camera.width, camera.height)
        # Only the box and a margin are ray-traced: the whole image would take three times as long.
        truth = self._true(camera.cropped(left, top, right - left, bottom - top), view)
        window = (slice(top, bottom), slice(left, right))
        true_mask = np.zeros((camera.height, camera.width), np.bool_)
        true_mask[window] = truth.instance == self._oracle.instance_of(self._track_id)
        inner = (rectangle[0] - left, rectangle[1] - top, rectangle[2] - left, rectangle[3] - top)
        camera_from_world = se3.inverse(view.world_from_camera)
        scores, pictures = {}, []
        for arm, actor in self._actors.items():
            image = self._drawn(arm, camera, view)[window]
            mask = actor_mask(actor, camera, camera_from_world, view.world_from_actor)
            scores[arm] = agreement(image, truth.rgb, inner, mask, true_mask, (left, top))
            pictures.append(image)
        gap = np.full((bottom - top, _GAP, 3), 255, np.uint8)
        return scores, np.concatenate([pictures[0], gap, pictures[1], gap, truth.rgb], axis=1)

    def whole(self, view: PlacedView) -> dict[str, Image]:
        """Whole images: by arm, then "truth"."""
        camera = self._mounts[view.camera].camera
        images = {arm: self._drawn(arm, camera, view) for arm in self._actors}
        return {**images, "truth": self._true(camera, view).rgb}

    def _drawn(self, arm: str, camera: PinholeCamera, view: PlacedView) -> Image:
        camera_from_world = se3.inverse(view.world_from_camera)
        poses = {self._track_id: view.world_from_actor}
        drawn = self._rasterizers[arm].render(camera, camera_from_world, poses)
        return np.rint(np.clip(drawn.rgb, 0.0, 1.0) * 255).astype(np.uint8)

    def _true(self, camera: PinholeCamera, view: PlacedView) -> OracleFrame:
        return self._oracle.render(
            camera,
            view.world_from_camera,
            {self._track_id: view.world_from_actor},
            timestamp_us=view.timestamp_us,
            exposure=self._exposures.get(view.camera, 1.0),
        )


def evaluate_oracle_views(
    log: DrivingLog,
    baseline: StreetScene,
    candidate: StreetScene,
    oracle: TrueWorld,
    track_id: str,
    mounts: Mapping[str, CameraMount],
    out: str | Path | None = None,
    *,
    rng: np.random.Generator,
    settings: ViewSettings | None = None,
    exposures: Mapping[str, float] | None = None,
    shares: Shares | None = None,
    progress: Progress | None = None,
) -> OracleViews:
    """Compare both actors with the truth where a closed loop may put them.

    The camera stands at logged poses, so that the background is as good as the reconstruction makes
    it; the vehicle stands before it on the road, turned through all headings. PSNR and SSIM are
    those of the image inside the projected box; the mask IoU compares the oracle's visible pixels
    of the vehicle with what the actor, drawn alone, covers by more than half (no shadow).

    Args:
        baseline, candidate: scenes in the log's world frame, with a model of the track.
        oracle: the world that the log was made from.
        mounts: cameras as they are rendered, see `camera_mounts`.
        out: folder to be made, whole or not at all: `oracle_views.json`, `view_000.png`, ... (the
            box and a margin, from left to right baseline, candidate, truth), and the whole images
            `showcase_baseline.png`, `showcase_candidate.png`, `showcase_truth.png` of one view.
        rng: random generator for the intervals.
        settings: settings that say which views are drawn; the default draws 36.
        exposures: exposures of the log's images, by camera; the truth's images are given them too.
            1 if missing.
        shares: shares of the candidate actor that were seen, mirrored and invented, if they are
            known; each view then tells them for what it shows.
        progress: called with the number of views done, and of all.

    Raises:
        InputError: the log or a scene has no such track, no logged image shows it, or there is no
            place for it on the recorded road; `out` exists.
    """
    if track_id not in log.tracks:
        raise InputError(
            log.name,
            f"track {track_id}",
            "is not in the log",
            f"choose one of {', '.join(log.tracks)}",
        )
    settings = ViewSettings() if settings is None else settings
    track = log.tracks[track_id]
    logged = logged_views(log, track)
    if len(logged) == 0:
        raise InputError(
            log.name, f"track {track_id}", "is not in any image of the log", "choose another track"
        )
    painter = Painter(
        {"baseline": baseline, "candidate": candidate},
        oracle,
        track_id,
        track.size,
        mounts,
        exposures or {},
    )
    placed = [
        (view, rectangle)
        for view in place_views(log, track, mounts, settings)
        if (rectangle := painter.rectangle(view)) is not None
    ]
    if not placed:
        raise InputError(
            log.name,
            f"track {track_id}",
            "is not visible at any of the distances ahead of the ego",
            "give other distances",
        )
    meter = None if shares is None else CoverageMeter(candidate, track_id, shares)
    with nullcontext() if out is None else atomic_folder(out) as folder:
        views = []
        for index, (view, rectangle) in enumerate(placed):
            direction = view_direction(view.world_from_actor, view.world_from_camera)
            scores, picture = painter.compare(view, rectangle)
            azimuth, elevation = azimuth_elevation(direction)
            views.append(
                OracleView(
                    index=index,
                    **{name: getattr(view, name) for name in _OF_PLACE},
                    azimuth=azimuth,
                    elevation=elevation,
                    angle=angle_to_nearest(direction, logged),
                    rectangle=rectangle,
                    baseline=scores["baseline"],
                    candidate=scores["candidate"],
                    coverage=None
                    if meter is None
                    else meter.measure(
                        mounts[view.camera].camera,
                        se3.inverse(view.world_from_camera),
                        {track_id: view.world_from_actor},
                    ),
                )
            )
            if folder is not None:
                _save(folder / views[-1].picture, picture)
            tell(progress, index + 1, len(placed))
        result = OracleViews(
            track_id, len(logged), tuple(views), summarise(views, rng), _furthest(views)
        )
        if folder is not None:
            for side, image in painter.whole(placed[result.showcase][0]).items():
                _save(folder / f"showcase_{side}.png", image)
            write_json(folder / RECORD_FILE, result.to_json())
    return result


def _furthest(views: list[OracleView]) -> int:
    nearest = min(view.distance for view in views)
    near = [view for view in views if view.distance < nearest + 0.01]
    return max(near, key=lambda view: (round(view.angle, 3), -view.index)).index


def _save(path: Path, image: NDArray[np.uint8]) -> None:
    PilImage.fromarray(image).save(path, format="PNG")
