from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from recast.actors import BoxLidarSegmenter, Observation, SegmentationTarget
from recast.actors.segment import mask_quality
from recast.geometry import se3
from recast.splats import Gaussians, rasterize
from support import made_up_actors as made_up


@pytest.fixture(scope="module")
def target(observation: Observation) -> SegmentationTarget:
    return SegmentationTarget(
        image=np.ascontiguousarray(observation.rgba[..., :3]),
        camera=observation.camera,
        camera_from_object=observation.camera_from_object,
        size=observation.size,
        object_points=observation.points.astype(np.float64),
        other_points=np.zeros((0, 3)),
    )


@pytest.fixture(scope="module")
def truth(target: SegmentationTarget, red_car: Gaussians) -> np.ndarray:
    with torch.no_grad():
        picture = rasterize(
            red_car,
            torch.from_numpy(target.camera_from_object).float(),
            torch.from_numpy(target.camera.matrix).float(),
            target.camera.width,
            target.camera.height,
        )
    return picture.alpha.numpy() > 0.5


def test_mask_is_the_car(observation: Observation, truth: np.ndarray) -> None:
    mask = observation.rgba[..., 3] > 127
    assert (mask & truth).sum() / (mask | truth).sum() > 0.93


def test_same_crop_same_mask(target: SegmentationTarget) -> None:
    first = BoxLidarSegmenter().segment(target)
    np.random.default_rng(1).random(10)
    assert np.array_equal(first, BoxLidarSegmenter().segment(target))


def test_quality_tells_good_from_bad(target: SegmentationTarget, truth: np.ndarray) -> None:
    good = mask_quality(target, truth.astype(np.uint8) * 255)
    assert good.warnings() == ()
    assert good.lidar_inside > 0.97
    everything = mask_quality(target, np.full(truth.shape, 255, np.uint8))
    assert everything.border_contact == 1.0
    assert len(everything.warnings()) >= 2
    half = truth.copy()
    half[:, : half.shape[1] // 2] = False
    assert mask_quality(target, half.astype(np.uint8) * 255).lidar_inside < 0.85


def test_road_returns_are_background(target: SegmentationTarget) -> None:
    """A LiDAR return in front of the box keeps its pixel out of the mask."""
    open_before = np.argwhere(BoxLidarSegmenter().trimap(target) == cv2.GC_PR_FGD)
    row, column = open_before[len(open_before) // 2]
    blocker = target.camera.unproject([[column + 0.5, row + 0.5]], [3.0])
    blocked = SegmentationTarget(
        target.image,
        target.camera,
        target.camera_from_object,
        target.size,
        target.object_points,
        blocker,
    )
    assert BoxLidarSegmenter().trimap(blocked)[row, column] == cv2.GC_BGD


def test_under_the_car_is_background(target: SegmentationTarget) -> None:
    """Between the wheels, below the body: shadow, not car."""
    ground = np.array([[0.0, made_up.SIZE[1] / 2, -made_up.SIZE[2] / 2 + 0.02]])
    camera_point = ground @ target.camera_from_object[:3, :3].T + target.camera_from_object[:3, 3]
    pixel, _ = target.camera.project(camera_point)
    column, row = pixel[0].astype(int)
    assert BoxLidarSegmenter().trimap(target)[row, column] == cv2.GC_BGD


def test_mask_ends_near_the_hull(target: SegmentationTarget) -> None:
    """Above the hull of the hits, the sky is no part of the car even where the box is too tall."""
    tall = SegmentationTarget(
        target.image,
        target.camera,
        target.camera_from_object,
        target.size * [1.0, 1.0, 1.6],
        target.object_points,
        target.other_points,
    )
    trimap = BoxLidarSegmenter().trimap(tall)
    pixels, _ = target.camera.project(
        se3.apply(target.camera_from_object, np.array([[0.0, 0.0, 0.75 * target.size[2]]]))
    )
    column, row = pixels[0].astype(int)
    assert trimap[row, column] == cv2.GC_BGD


def test_dark_apron_is_the_car(target: SegmentationTarget, truth: np.ndarray) -> None:
    """Low parts that the LiDAR hit are the car whatever their colour, down to near the edge."""
    sure = BoxLidarSegmenter().trimap(target) == cv2.GC_FGD
    assert (sure & ~truth).sum() < 0.01 * truth.sum()
    rows = np.nonzero(truth)[0]
    low = truth.copy()
    low[: int(0.35 * rows.min() + 0.65 * rows.max())] = False
    assert sure[low].mean() > 0.72  # 0.68 by the core of the hull alone
