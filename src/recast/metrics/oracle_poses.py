"""Views that a closed loop needs, all around the vehicle, and how far they are from logged ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recast.actors.views import score_frame
from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.dynamics import PACIFICA
from recast.geometry import boxes, se2, se3
from recast.logs import DrivingLog, Track
from recast.planning import ReferenceRoute
from recast.scene.poses import moves
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
    log: DrivingLog,
    track: Track,
    mounts: Mapping[str, CameraMount],
    settings: ViewSettings,
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
