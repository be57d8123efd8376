"""Points from several views where the LiDAR does not reach: a plane sweep.

Every depth hypothesis warps neighbouring images onto the reference view by the homography of a
fronto-parallel plane; the hypothesis under which they agree best with the reference wins (Collins
1996). Costs are sums of absolute differences over a window, and the best two neighbours count, so
that a neighbour that is occluded there does no harm (Kang et al. 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Float32Array, Mask
from recast.cameras import PinholeCamera
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import TrainingView


def sweep_depths(
    views: Sequence[TrainingView],
    references: Sequence[int],
    wanted: Sequence[Mask],
    threads: int = 1,
    range_m: tuple[float, float] = INIT.sweep_range_m,
) -> list[Float32Array]:
    """Depth maps (H, W) of reference views, metres along the camera axis, 0 where unknown.

    Args:
        views: views of one camera in order of time; neighbours are taken from these alone.
        references: indices into `views`.
        wanted: (H, W) mask per reference: pixels outside are not asked for.
        range_m: nearest and farthest depth that is tried, metres.
    """
    near, far = range_m
    inverse = np.linspace(1 / far, 1 / near, INIT.sweep_hypotheses)

    def run(task: tuple[int, Mask]) -> Float32Array:
        reference, mask = task
        beside = [reference + step for step in INIT.sweep_neighbours]
        neighbours = [views[number] for number in beside if 0 <= number < len(views)]
        return _sweep(views[reference], neighbours, mask, inverse)

    tasks = list(zip(references, wanted, strict=True))
    if threads <= 1:
        return [run(task) for task in tasks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(run, tasks))


def _sweep(
    reference: TrainingView, neighbours: Sequence[TrainingView], wanted: Mask, inverse: Array
) -> Float32Array:
    result = np.zeros(wanted.shape, np.float32)
    rows = np.flatnonzero(wanted.any(axis=1))
    if len(rows) == 0 or len(neighbours) < 2:
        return result
    half = INIT.sweep_window_px // 2
    top, bottom = max(0, rows[0] - half), min(len(wanted), rows[-1] + half + 1)
    image = _grey(reference)[top:bottom]
    camera = reference.camera.cropped(0, int(top), reference.camera.width, int(bottom - top))
    greys = [_grey(other) for other in neighbours]
    volume = np.empty((len(inverse), *image.shape[:2]), np.float32)
    for i, value in enumerate(inverse):
        costs = [
            _cost(image, camera, reference, other, grey, value)
            for other, grey in zip(neighbours, greys, strict=True)
        ]
        volume[i] = _mean_of_best_two(costs)
    index, accepted = _winner(volume)
    grey = image.astype(np.float32) / 255
    size = (INIT.sweep_window_px, INIT.sweep_window_px)
    variance = cv2.blur(grey * grey, size) - cv2.blur(grey, size) ** 2
    accepted &= variance > INIT.sweep_least_texture**2
    accepted &= wanted[top:bottom]
    step = inverse[1] - inverse[0]
    depth = 1 / (inverse[0] + index * step)
    result[top:bottom][accepted] = depth[accepted]
    return result


def _cost(
    image: NDArray[np.uint8],
    camera: PinholeCamera,
    reference: TrainingView,
    other: TrainingView,
    other_grey: NDArray[np.uint8],
    inverse_depth: float,
) -> Float32Array:
    """Mean absolute difference (H, W) in [0, 1] over windows; high where one is not seen."""
    other_from_reference = other.camera_from_world @ reference.world_from_camera
    plane = other_from_reference[:3, :3].copy()
    plane[:, 2] += other_from_reference[:3, 3] * inverse_depth  # R + t n^T / d with n = z
    homography = other.camera.matrix @ plane @ np.linalg.inv(camera.matrix)
    shift = np.array([[1.0, 0, -0.5], [0, 1.0, -0.5], [0, 0, 1.0]])  # OpenCV's pixel centres
    homography = shift @ homography @ np.linalg.inv(shift)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpPerspective(other_grey, homography, size, flags=flags)
    difference = cv2.absdiff(image, warped)
    difference[warped == 0] = 255  # `_grey` keeps 0 for what lies outside the image
    cost = cv2.boxFilter(difference, cv2.CV_32F, (INIT.sweep_window_px, INIT.sweep_window_px))
    return np.asarray(cost, np.float32) * np.float32(1 / 255)


def _grey(view: TrainingView) -> NDArray[np.uint8]:
    return np.maximum(cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY), 1)


def _mean_of_best_two(costs: Sequence[Float32Array]) -> Float32Array:
    best = np.minimum(costs[0], costs[1])
    second = np.maximum(costs[0], costs[1])
    for cost in costs[2:]:
        second = np.minimum(second, np.maximum(best, cost))
        best = np.minimum(best, cost)
    return (best + second) * np.float32(0.5)


def _winner(volume: Float32Array) -> tuple[Array, Mask]:
    """Best hypothesis at every pixel, refined by a parabola, and whether it is to be trusted."""
    count = len(volume)
    best = volume.argmin(axis=0)
    cost = np.take_along_axis(volume, best[None], 0)[0]
    interior = (best > 0) & (best < count - 1)
    middle = np.clip(best, 1, count - 2)
    before = np.take_along_axis(volume, middle[None] - 1, 0)[0]
    centre = np.take_along_axis(volume, middle[None], 0)[0]
    after = np.take_along_axis(volume, middle[None] + 1, 0)[0]
    curvature = before - 2 * centre + after
    offset = np.where(curvature > 1e-6, 0.5 * (before - after) / np.maximum(curvature, 1e-6), 0.0)
    index = best + np.where(interior, np.clip(offset, -0.5, 0.5), 0.0)
    rival = np.full(cost.shape, np.inf, np.float32)
    for i in range(count):
        far_off = np.abs(best - i) > 3
        np.minimum(rival, np.where(far_off, volume[i], np.inf), out=rival)
    # The nearest hypothesis is where all that is nearer still ends up; the farthest is honest.
    better = (cost < INIT.sweep_most_cost) & (rival > INIT.sweep_least_ratio * cost)
    return index, better & (best < count - 1)
