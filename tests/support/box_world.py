"""A world of one coloured box under an even sky: its log, its truth, and two reconstructions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from recast.actors.actor import Shares
from recast.cameras import CameraMount, PinholeCamera
from recast.geometry import se2, se3
from recast.logs.types import CameraStream, DrivingLog, Track, Trajectory
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.splats import Gaussians

SIZE = np.array([4.2, 1.8, 1.5])
SKY = np.array([0.5, 0.6, 0.7])
FACES = {  # outward normal to colour
    (1, 0, 0): (0.9, 0.8, 0.2),
    (-1, 0, 0): (0.8, 0.1, 0.1),
    (0, 1, 0): (0.1, 0.6, 0.2),
    (0, -1, 0): (0.2, 0.3, 0.8),
    (0, 0, 1): (0.6, 0.6, 0.6),
}
CAMERA = PinholeCamera(96, 64, 100.0, 100.0, 48.0, 32.0)
RIG_FROM_CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [1.5, 0.0, 2.0]
)
MOUNTS = {"front": CameraMount(CAMERA, RIG_FROM_CAMERA)}


class NoImages:
    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> np.ndarray:
        raise IndexError(index)


def box_log(parked: Track | None = None) -> DrivingLog:
    """An ego driving 60 m along x at 10 m/s behind the box "7", 14 m ahead in its own lane."""
    times = np.arange(61, dtype=np.int64) * 100_000
    x = 1.0 * np.arange(61)
    ego = np.stack([x, 0 * x, 0 * x], axis=1)
    target = se2.to_se3(np.stack([x + 14.0, 0 * x, 0 * x], axis=1), SIZE[2] / 2)
    tracks = {"7": Track("7", "car", SIZE, Trajectory(times, target))}
    if parked is not None:
        tracks[parked.track_id] = parked
    stream = CameraStream("front", CAMERA, RIG_FROM_CAMERA, times[::10], NoImages())
    return DrivingLog("boxes", {"front": stream}, {}, Trajectory(times, se2.to_se3(ego)), tracks)


def parked_at(x: float, y: float) -> Track:
    """A vehicle that never moves."""
    pose = se2.to_se3(np.array([x, y, 0.0]), SIZE[2] / 2)
    return Track("p", "car", SIZE, Trajectory(np.array([0, 6_000_000]), np.stack([pose, pose])))


@dataclass(frozen=True)
class Frame:
    rgb: np.ndarray
    instance: np.ndarray


class BoxOracle:
    """Casts rays at the box."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, int, int, float]] = []

    def instance_of(self, track_id: str) -> int:
        return {"7": 3}[track_id]

    def render(self, camera, world_from_camera, poses, timestamp_us, exposure):
        self.calls.append((camera.width, camera.height, timestamp_us, exposure))
        actor_from_camera = se3.inverse(poses["7"]) @ world_from_camera
        rays = camera.rays(camera.pixel_grid()).reshape(-1, 3) @ actor_from_camera[:3, :3].T
        rays = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
        start = actor_from_camera[:3, 3]
        first, last = (-SIZE / 2 - start) / rays, (SIZE / 2 - start) / rays
        near, far = np.minimum(first, last), np.maximum(first, last)
        enter = near.max(axis=1)
        hit = (enter < far.min(axis=1)) & (enter > 0)
        rgb = np.tile(SKY, (len(rays), 1))
        axis = near.argmax(axis=1)
        for normal, colour in FACES.items():
            k = int(np.flatnonzero(normal)[0])
            rgb[hit & (axis == k) & (np.sign(rays[:, k]) == -normal[k])] = colour
        shape = (camera.height, camera.width)
        image = np.rint(np.clip(exposure * rgb, 0, 1) * 255).astype(np.uint8)
        instance = np.where(hit, 3, 0).astype(np.uint16)
        return Frame(image.reshape(*shape, 3), instance.reshape(shape))


def scene(faces: tuple[tuple[int, int, int], ...], log: DrivingLog) -> StreetScene:
    """The box reconstructed on some of its faces only."""
    parts = []
    for normal in faces:
        k = int(np.flatnonzero(normal)[0])
        spans = [
            np.arange(-h + 0.05, h, 0.1) if i != k else [normal[i] * (h - 0.02)]
            for i, h in enumerate(SIZE / 2)
        ]
        points = np.stack(np.meshgrid(*spans, indexing="ij"), -1).reshape(-1, 3)
        parts.append((points, np.tile(FACES[normal], (len(points), 1))))
    means = torch.tensor(np.concatenate([p for p, _ in parts]), dtype=torch.float32)
    colours = torch.tensor(np.concatenate([c for _, c in parts]), dtype=torch.float32)
    track = log.tracks["7"]
    actor = SceneActor("7", _blobs(means, colours, 0.05), track.size, track.trajectory)
    nowhere = _blobs(torch.tensor([[0.0, 0.0, -500.0]]), torch.zeros(1, 3), 0.01)
    sky = SkyMap.constant(torch.tensor(SKY, dtype=torch.float32))
    return StreetScene(nowhere, {"7": actor}, sky)


def box_shares(street: StreetScene) -> Shares:
    """The box's rear was seen, its left is mirrored, the rest invented."""
    means = street.actors["7"].gaussians.means
    edge = torch.from_numpy(SIZE).float() / 2 - 0.03
    rear, left = means[:, 0] < -edge[0], means[:, 1] > edge[1]
    return Shares(rear.float(), (left & ~rear).float())


def _blobs(means: torch.Tensor, colours: torch.Tensor, scale: float) -> Gaussians:
    return Gaussians(
        means=means,
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(len(means), 1),
        log_scales=torch.full((len(means), 3), float(np.log(scale))),
        logit_opacities=torch.full((len(means),), 4.0),
        sh=((colours - 0.5) / 0.28209479).reshape(-1, 1, 3),
    )
