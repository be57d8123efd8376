"""Which pixels count, and how they are scored."""

from __future__ import annotations

import numpy as np
import pytest

from recast.cameras import PinholeCamera
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, Track, Trajectory
from recast.reconstruction.scores import (
    LPIPS_SIDE,
    MovingRegion,
    RegionScore,
    mean_score,
    moving_region,
    moving_tracks,
    score_regions,
)
from recast.reconstruction.views import TrainingView

CAMERA = PinholeCamera(120, 80, 100.0, 100.0, 60.0, 40.0)
SIZE = np.array([4.0, 2.0, 1.5])
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""Camera from a rig that looks along x."""


def view(image: np.ndarray | None = None, mask: np.ndarray | None = None) -> TrainingView:
    image = np.zeros((80, 120, 3), np.uint8) if image is None else image
    return TrainingView("front", 3, 500_000, CAMERA, se3.inverse(AHEAD), image, mask, True)


def driving(x: float, y: float = 0.0, yaw: float = 0.0) -> Track:
    """At (x, y, 0) half a second into a drive along x at 6 m/s."""
    poses = [
        se3.from_rotation_translation(se3.rotation_z(yaw), [x + moved, y, 0.0])
        for moved in (-3.0, 0.0, 3.0)
    ]
    return Track("7", "car", SIZE, Trajectory(np.array([0, 500_000, 1_000_000]), np.stack(poses)))


def test_moving_pixels_are_those_of_the_widened_box() -> None:
    region = moving_region({"7": driving(20.0)}, view())
    # Nearest face: 3 m before the centre, 3 m wide, 1.5 m high.
    half_width, half_height = 100 * 1.5 / 17, 100 * 0.75 / 17
    rows, columns = np.nonzero(region.mask)
    # All pixel centres between the edges, and none beyond.
    assert 0 <= columns.min() + 0.5 - (60 - half_width) < 1
    assert 0 <= 60 + half_width - (columns.max() + 0.5) < 1
    assert 0 <= rows.min() + 0.5 - (40 - half_height) < 1
    assert 0 <= 40 + half_height - (rows.max() + 0.5) < 1
    assert region.mask.sum() == pytest.approx(4 * half_width * half_height, rel=0.1)
    ((left, top, right, bottom),) = region.rectangles
    assert (left, top) == (int(60 - half_width), int(40 - half_height))
    assert right - left == 18 and bottom - top == 10


def test_a_turned_box_fills_less_than_its_rectangle() -> None:
    region = moving_region({"7": driving(12.0, 1.0, np.pi / 4)}, view())
    ((left, top, right, bottom),) = region.rectangles
    share = region.mask[top:bottom, left:right].mean()
    assert 0.6 < share < 0.97
    assert region.mask.sum() == region.mask[top:bottom, left:right].sum()
    corners = boxes.corners(SIZE, AHEAD @ driving(12.0, 1.0, np.pi / 4).trajectory.poses[1])
    pixels = np.floor(CAMERA.project(corners)[0]).astype(int)
    assert region.mask[pixels[:, 1], pixels[:, 0]].all()  # the true box lies within


def test_nothing_behind_and_nothing_absent() -> None:
    behind = moving_region({"7": driving(-20.0)}, view())
    assert not behind.mask.any() and behind.rectangles == ()
    short = driving(20.0)
    gone = Trajectory(np.array([900_000, 1_000_000]), short.trajectory.poses[:2])
    assert moving_region({"7": Track("7", "car", SIZE, gone)}, view()).rectangles == ()


def test_a_box_beside_the_camera_is_cut_at_the_near_plane() -> None:
    region = moving_region({"7": driving(1.0, 2.0)}, view())
    assert region.mask[:, 0].any() and not region.mask[:, 119].any()


def test_only_moving_tracks_count(tiny_log: DrivingLog) -> None:
    assert set(moving_tracks(tiny_log)) == {"0"}


def test_errors_count_where_they_are() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(60, 200, (80, 120, 3)).astype(np.uint8)
    mask = np.zeros((80, 120), bool)
    mask[20:40, 30:70] = True
    region = MovingRegion(mask, ((30, 20, 70, 40),))
    drawn = image.astype(np.float32) / 255
    drawn[mask] += 0.1
    whole, moving = score_regions(drawn, view(image), region, None)
    assert moving is not None and moving.psnr == pytest.approx(20.0, abs=1e-4)
    assert whole.psnr == pytest.approx(20.0 + 10 * np.log10(mask.size / mask.sum()), abs=1e-4)
    assert moving.ssim < whole.ssim < 1.0
    assert whole.lpips is None and moving.lpips is None

    usable = ~mask
    assert score_regions(drawn, view(image, usable), region, None)[1] is None
    outside = np.where(mask[..., None], image / 255, image / 255 + 0.1).astype(np.float32)
    assert score_regions(outside, view(image, usable), region, None)[0].psnr == pytest.approx(
        20.0, abs=1e-4
    )
    same = score_regions(image.astype(np.float32) / 255, view(image), region, None)[0]
    assert same.psnr == 100.0 and same.ssim == pytest.approx(1.0)


def test_lpips_looks_around_each_box_and_never_at_a_scrap() -> None:
    shapes = []

    def distance(first: np.ndarray, second: np.ndarray) -> float:
        assert first.shape == second.shape
        shapes.append(first.shape[:2])
        return float(len(shapes))

    mask = np.ones((80, 120), bool)
    region = MovingRegion(mask, ((0, 0, 10, 5), (110, 70, 120, 80), (0, 0, 120, 10)))
    whole, moving = score_regions(np.zeros((80, 120, 3), np.float32), view(), region, distance)
    assert shapes == [(80, 120), (LPIPS_SIDE,) * 2, (LPIPS_SIDE,) * 2, (LPIPS_SIDE, 120)]
    assert whole.lpips == 1.0 and moving is not None and moving.lpips == 3.0


def test_means() -> None:
    assert mean_score([]) is None
    scores = [RegionScore(20.0, 0.5), RegionScore(30.0, 0.7)]
    assert mean_score(scores) == RegionScore(25.0, pytest.approx(0.6), None)
    assert mean_score([RegionScore(20.0, 0.5, 0.2)] * 2) == RegionScore(20.0, 0.5, 0.2)
