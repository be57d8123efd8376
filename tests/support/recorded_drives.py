"""Drives whose images are made up, and a planner that looks at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recast.arrays import Array
from recast.cameras import PinholeCamera, View
from recast.cameras.mounts import camera_pose
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.planning import BasePlanner, Plan, PlannerInput

START = 1_700_000_000_000_000
TIMES = START + 100_000 * np.arange(91, dtype=np.int64)
WIDE = PinholeCamera(160, 80, 60.0, 60.0, 80.0, 40.0)


def poses(x: Array, y: float = 0.0, heading: float = 0.0) -> Array:
    turn = se3.from_rotation_translation(se3.rotation_z(heading), np.zeros(3))
    found = np.tile(turn, (len(x), 1, 1))
    found[:, 0, 3], found[:, 1, 3] = x, y
    return found


class Azimuths:
    """Images whose red says how far left a pixel looks, and whose blue counts the frames."""

    def __len__(self) -> int:
        return len(TIMES)

    def __getitem__(self, index: int, /) -> Array:
        rays = WIDE.rays(WIDE.pixel_grid())
        left = np.degrees(np.arctan2(-rays[..., 0], rays[..., 2]))
        image = np.zeros((80, 160, 3), np.uint8)
        image[..., 0] = np.clip(128 + 2 * left, 0, 255)
        image[..., 2] = index
        return image


def log(
    speed: Array | float = 10.0, tracks: Sequence[Track] = (), images: bool = True
) -> DrivingLog:
    x = np.cumsum(np.broadcast_to(speed, len(TIMES)) * 0.1)
    mount = camera_pose((1.5, 0.0, 1.5), 0.0, 0.0)
    stream = CameraStream("cam", WIDE, mount, TIMES, Azimuths())
    return DrivingLog(
        name="straight",
        cameras={"cam": stream} if images else {},
        lidars={},
        world_from_rig=Trajectory(TIMES, poses(x)),
        tracks={track.track_id: track for track in tracks},
    )


def car(x: float, y: float = 0.0, speed: float = 0.0, heading: float = 0.0) -> Track:
    places = x + speed * 0.1 * np.arange(len(TIMES))
    size = np.array([4.4, 1.8, 1.5])
    return Track("7", "car", size, Trajectory(TIMES, poses(places, y, heading)))


class Looker(BasePlanner):
    """Stands still in every fourth moment; else drives by the red in the middle of its view."""

    name = "looker"
    needs_images = True
    wanted_views = (View("left", PinholeCamera(60, 40, 60.0, 60.0, 30.0, 20.0), 30.0),)

    def __init__(self) -> None:
        self.seen: list[PlannerInput] = []

    def choose_cameras(self, mounts: object) -> Sequence[str]:
        return ["virtual_left"]

    def plan(self, observation: PlannerInput) -> Plan:
        self.seen.append(observation)
        red = float(observation.images["virtual_left"][20, 28:32, 0].mean())
        waypoints = np.zeros((40, 3))
        speed = 0.0 if observation.step % 4 == 3 else 10.0 + (red - 188.0)
        waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
        return Plan(waypoints)
