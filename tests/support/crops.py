"""A made-up folder of vehicle crops: a box on wheels, green in front and red behind."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import torch

from recast.cameras import PinholeCamera
from recast.recar.views import pinhole
from recast.scene.actor import look_at
from recast.splats import Gaussians, rasterize

SIZE = (4.4, 1.8, 1.4)
PIXELS = 96
FOV_DEG, DISTANCE = 30.0, 13.0
CAMERA = pinhole(PIXELS, PIXELS, FOV_DEG)
SH_C0 = 0.28209479177387814
# Azimuth and elevation in degrees in the actor frame: 0 ahead, 90 to the left.
INPUTS = ((130.0, 4.0),)
RESERVED = ((40.0, 3.0), (200.0, 10.0))


def two_coloured_box(spread: float = 0.07) -> Gaussians:
    """A vehicle in the actor frame, longer than wide: cabin behind, green nose, red tail."""
    rng = np.random.default_rng(0)
    half = np.array(SIZE) / 2 - 1.5 * spread  # Gaussians reach beyond their centres
    parts = [
        surface_of(rng, -half, [half[0], half[1], 0.0]),
        surface_of(rng, [-half[0], -half[1], 0.0], [0.2, half[1], half[2]]),
    ]
    points = np.concatenate(parts)
    colour = np.where(points[:, :1] > 0.7, [[0.15, 0.75, 0.2]], [[0.8, 0.1, 0.1]])
    colour = np.where(points[:, 2:] > 0.25, [[0.2, 0.25, 0.6]], colour)
    count = len(points)
    return Gaussians(
        torch.tensor(points, dtype=torch.float32),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        torch.full((count, 3), float(np.log(spread))),
        torch.full((count,), 4.0),
        torch.tensor((colour - 0.5) / SH_C0, dtype=torch.float32)[:, None],
    )


def surface_of(rng: np.random.Generator, low: object, high: object) -> np.ndarray:
    """Points (N, 3) on the faces of a box between two corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    faces = []
    for axis in range(3):
        for end in (low[axis], high[axis]):
            face = rng.uniform(low, high, (240, 3))
            face[:, axis] = end
            faces.append(face)
    return np.concatenate(faces)


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Unit vector to the camera in the actor frame."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def photograph(
    gaussians: Gaussians,
    azimuth: float,
    elevation: float,
    camera: PinholeCamera = CAMERA,
    distance: float = DISTANCE,
) -> np.ndarray:
    """(H, W, 4) uint8 before a grey street."""
    pose = look_at(distance * direction(azimuth, elevation), np.zeros(3))
    with torch.no_grad():
        picture = rasterize(
            gaussians,
            torch.from_numpy(pose).float(),
            torch.from_numpy(camera.matrix).float(),
            camera.width,
            camera.height,
            background=torch.full((3,), 0.4),
        )
    rgb = (picture.rgb.clamp(0, 1).numpy() * 255).round().astype(np.uint8)
    alpha = np.where(picture.alpha.numpy() > 0.5, 255, 0).astype(np.uint8)
    return np.dstack([rgb, alpha])


def camera_record(views: tuple[tuple[float, float], ...]) -> dict[str, object]:
    """camera.json of those views; its frame is the actor frame turned half around."""
    return {
        "frame_filenames": [f"frame_{i:02d}.png" for i in range(len(views))],
        "mask_filenames": [f"mask_{i:02d}.png" for i in range(len(views))],
        "normalized_cam_positions": [
            (direction(*view) * [-1.0, -1.0, 1.0]).tolist() for view in views
        ],
        "cam_dists": [DISTANCE] * len(views),
        "cam_fovs": [FOV_DEG] * len(views),
        "object_lwh": list(SIZE),
    }


def write_crops(
    root: Path,
    ids: tuple[str, ...] = ("car-a",),
    inputs: tuple[tuple[float, float], ...] = INPUTS,
) -> Path:
    """A folder of vehicles, all alike."""
    vehicle = two_coloured_box()
    for name in ids:
        for part, views in (("input_views", inputs), ("reserved_views", RESERVED)):
            folder = root / name / part
            folder.mkdir(parents=True)
            for index, view in enumerate(views):
                rgba = photograph(vehicle, *view)
                cv2.imwrite(str(folder / f"frame_{index:02d}.png"), rgba[..., 2::-1])
                cv2.imwrite(str(folder / f"mask_{index:02d}.png"), rgba[..., 3])
            (folder / "camera.json").write_text(json.dumps(camera_record(views)))
    return root
