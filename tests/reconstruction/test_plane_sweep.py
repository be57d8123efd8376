from __future__ import annotations

import cv2
import numpy as np

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.reconstruction.points import sweep_depths
from recast.reconstruction.views import TrainingView

CAMERA = PinholeCamera(120, 60, 90.0, 90.0, 60.0, 30.0)


def wall_view(frame: int, centre: np.ndarray, depth: float, texture: np.ndarray) -> TrainingView:
    """A camera looking along z at a textured wall at z = depth."""
    pixels = CAMERA.pixel_grid()
    points = centre + CAMERA.unproject(pixels, np.full(pixels.shape[:2], depth - centre[2]))
    uv = ((points[..., :2] + 20) * 12).astype(np.float32)  # 12 texels a metre
    image = cv2.remap(texture, uv[..., 0] - 0.5, uv[..., 1] - 0.5, cv2.INTER_LINEAR)
    pose = se3.from_rotation_translation(np.eye(3), centre)
    return TrainingView("front", frame, frame * 100_000, CAMERA, pose, image, None, False)


def test_depth_of_a_textured_wall() -> None:
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.random((480, 480, 3)), (0, 0), 1.5)
    noise = (noise - noise.min()) / (noise.max() - noise.min())
    texture = (255 * noise).astype(np.uint8)
    depth = 14.0
    views = [
        wall_view(i, np.array([0.25 * i - 0.5, 0.02 * i, 0.1 * i]), depth, texture)
        for i in range(5)
    ]
    wanted = np.ones((60, 120), bool)
    wanted[:, :10] = False
    (found,) = sweep_depths(views, [2], [wanted], range_m=(4.0, 60.0))
    assert (found[:, :10] == 0).all()
    inner = found[10:-10, 20:-20]
    known = inner > 0
    assert known.mean() > 0.6
    expected = depth - 0.2  # along the camera's axis
    assert np.median(np.abs(inner[known] - expected)) < 0.4
    assert (np.abs(inner[known] / expected - 1) < 0.1).mean() > 0.9


def test_a_blank_wall_gives_nothing() -> None:
    blank = np.full((480, 480, 3), 128, np.uint8)
    views = [wall_view(i, np.array([0.3 * i, 0.0, 0.0]), 10.0, blank) for i in range(5)]
    (found,) = sweep_depths(views, [2], [np.ones((60, 120), bool)])
    assert not found.any()


def test_one_neighbour_is_too_few() -> None:
    texture = np.zeros((480, 480, 3), np.uint8)
    views = [wall_view(i, np.zeros(3), 10.0, texture) for i in range(2)]
    (found,) = sweep_depths(views, [0], [np.ones((60, 120), bool)])
    assert not found.any()
