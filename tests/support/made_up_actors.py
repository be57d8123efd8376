"""A made-up street: a red car drives past a camera and a LiDAR that stand still."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch

from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import SurfaceCloud, build_cloud
from recast.actors.template.design import STYLES
from recast.actors.template.generator import vehicle_gaussians
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear
from recast.logs import CameraStream, DrivingLog, LidarStream, LidarSweep, Track, Trajectory
from recast.splats import Gaussians, rasterize

SIZE = np.array([4.4, 1.75, 1.45])
RED = np.array([0.62, 0.05, 0.06])
GREY = np.array([0.37, 0.38, 0.36])  # a road in daylight
FRAMES = 5
STEP_US = 100_000
CAMERA = PinholeCamera(320, 180, 260.0, 260.0, 160.0, 90.0)
# The camera looks along the rig's x axis from 1.5 m above the ground.
RIG_FROM_CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 1.5]
)


def car(size: np.ndarray = SIZE, paint: np.ndarray = RED, style: str = "estate") -> Gaussians:
    """A coarse template car in the actor frame, nothing photographed; made once, to be read."""
    return _car(tuple(size), tuple(paint), style)


@cache
def _car(size: tuple[float, ...], paint: tuple[float, ...], style: str) -> Gaussians:
    body = TemplateBody(np.array(size), STYLES[style])
    cloud = build_cloud(body, 0.04, np.random.default_rng(0))
    return vehicle_gaussians(body, cloud, gamma_to_linear(np.array(paint)))


@cache
def _met_by_lidar() -> SurfaceCloud:
    return build_cloud(TemplateBody(SIZE, STYLES["estate"]), 0.04, np.random.default_rng(1))


def car_poses() -> np.ndarray:
    """`world_from_object` (F, 4, 4): drives away on the right, headed a little to the left."""
    poses = []
    for frame in range(FRAMES):
        rotation = se3.rotation_z(0.35)
        centre = np.array([6.0, -2.2, SIZE[2] / 2]) + rotation @ [1.4 * frame, 0.0, 0.0]
        poses.append(se3.from_rotation_translation(rotation, centre))
    return np.array(poses)


def lidar_hits(rng: np.random.Generator, eye: np.ndarray, count: int = 1500) -> np.ndarray:
    """Points (N, 3) on the car's body and wheels that face `eye`, actor frame, 1 cm noise."""
    cloud = _met_by_lidar()
    points = cloud.points - [0.0, 0.0, SIZE[2] / 2]
    facing = np.flatnonzero(np.sum(cloud.normals * (eye - points), axis=1) > 0.3)
    chosen = points[rng.choice(facing, count, replace=False)]
    return chosen + rng.normal(0.0, 0.01, chosen.shape)


@dataclass(frozen=True)
class Frames:
    """Images in memory."""

    images: list[np.ndarray]

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> np.ndarray:
        return self.images[index]


@dataclass(frozen=True)
class Sweeps:
    """Sweeps in memory."""

    sweeps: list[LidarSweep]

    def __len__(self) -> int:
        return len(self.sweeps)

    def __getitem__(self, index: int) -> LidarSweep:
        return self.sweeps[index]


def turning_poses() -> np.ndarray:
    """`world_from_object` (F, 4, 4): on one spot, turned by 40 degrees a frame, its left first."""
    centre = [8.0, 0.0, SIZE[2] / 2]
    angles = -np.pi / 2 + np.radians(40.0) * np.arange(FRAMES)
    return np.array([se3.from_rotation_translation(se3.rotation_z(a), centre) for a in angles])


def street_log(vehicle: Gaussians, poses: np.ndarray | None = None) -> DrivingLog:
    """Five frames of the car "7", a car "8" hidden behind it, one "9" never in view and one "10"
    that the LiDAR missed."""
    rng = np.random.default_rng(0)
    times = np.arange(FRAMES, dtype=np.int64) * STEP_US
    poses = car_poses() if poses is None else poses
    images, sweeps = [], []
    for frame, pose in enumerate(poses):
        camera_from_object = se3.inverse(RIG_FROM_CAMERA) @ pose
        with torch.no_grad():
            picture = rasterize(
                vehicle,
                torch.from_numpy(camera_from_object).float(),
                torch.from_numpy(CAMERA.matrix).float(),
                CAMERA.width,
                CAMERA.height,
                background=torch.tensor(GREY, dtype=torch.float32),
            )
        noise = rng.normal(0.0, 0.01, picture.rgb.shape)
        images.append((np.clip(picture.rgb.numpy() + noise, 0, 1) * 255).astype(np.uint8))
        eye = se3.inverse(camera_from_object)[:3, 3]
        hits = se3.apply(pose, lidar_hits(rng, eye))
        ground = np.c_[rng.uniform(3, 25, 800), rng.uniform(-8, 8, 800), np.zeros(800)]
        points = np.concatenate([hits, ground]).astype(np.float32)
        sweeps.append(LidarSweep(int(times[frame]), points, np.zeros(len(points), np.float32)))
    still = np.tile(np.eye(4), (FRAMES, 1, 1))

    def track(name: str, track_poses: np.ndarray) -> Track:
        return Track(name, "car", SIZE, Trajectory(times, track_poses))

    behind, passed, unseen = poses.copy(), still.copy(), still.copy()
    behind[:, :3, 3] += (
        6.0
        * (poses[:, :3, 3] - [0, 0, 0.7])
        / np.linalg.norm(poses[:, :3, 3], axis=1, keepdims=True)
    )
    passed[:, :3, 3] = [-12.0, 0.0, 0.7]
    unseen[:, :3, 3] = [22.0, 5.0, 9.0]
    return DrivingLog(
        name="made-up street",
        cameras={"front": CameraStream("front", CAMERA, RIG_FROM_CAMERA, times, Frames(images))},
        lidars={"top": LidarStream("top", np.eye(4), times, Sweeps(sweeps))},
        world_from_rig=Trajectory(times, still),
        tracks={
            "7": track("7", poses),
            "8": track("8", behind),
            "9": track("9", passed),
            "10": track("10", unseen),
        },
    )
