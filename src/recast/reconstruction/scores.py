"""Scores of a redrawn image: PSNR, SSIM, of all that is usable in it and of what moves; depths."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache

import cv2
import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from recast.arrays import Array, Mask
from recast.cameras import box_outline
from recast.logs import DrivingLog, LidarStream, Track
from recast.reconstruction.points import OwnedSweep, depth_samples, read_sweeps
from recast.reconstruction.views import TrainingView
from recast.scene.street_scene import SceneImage, moves, pose_at

WINDOW = 11
SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2
Distance = Callable[[Array, Array], float]
"""A distance of two images (H, W, 3) in [0, 1], at least 32 pixels wide and high: LPIPS."""
Rectangle = tuple[int, int, int, int]
"""Left, top, right, bottom in whole pixels; right and bottom are one past the last."""
BOX_GROWTH = (1.5, 1.5, 1.0)
"""Factors of length, width and height: what a moving object's pixels are taken from."""
MIN_MOVING_PX = 64
"""Images with fewer moving pixels have no score for them."""
LPIPS_SIDE = 64
"""Rectangles are grown to this before LPIPS looks at them."""
PSNR_CAP = 100.0
"""dB given to equal pixels; JSON knows no infinity."""
SWEEP_REACH_US = 120_000
"""Sweeps further from an image in time are not its own: KITTI's may miss every other frame."""
SURFACE_ALPHA = 0.5
"""Where the scene covers less of a pixel, it has no surface there."""


def psnr(image: ArrayLike | Tensor, reference: ArrayLike | Tensor) -> float:
    """Peak signal-to-noise ratio in dB: -10 log10 of the mean squared error.

    Args:
        image, reference: (..., 3), values in [0, 1], equal shapes.

    Returns:
        infinity for equal images.

    >>> round(psnr([[0.5]], [[0.4]]), 4)
    20.0
    """
    first, second = _pair(image, reference)
    error = float((first - second).square().mean())
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


def ssim(image: ArrayLike | Tensor, reference: ArrayLike | Tensor) -> float:
    """Mean structural similarity of two images (H, W, C) with values in [0, 1].

    See `ssim_map`. float64.
    """
    return float(ssim_map(*_pair(image, reference)).mean())


def ssim_map(image: Tensor, reference: Tensor) -> Tensor:
    """Structural similarity at every pixel, (H, W, C), differentiable.

    (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sx^2 + sy^2 + C2)) with moments under an
    11 x 11 Gaussian window, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2 (Wang et al. 2004,
    eq. 13; the padding is 3D Gaussian splatting's).
    """
    x = image.movedim(-1, 0)[:, None]
    y = reference.movedim(-1, 0)[:, None]
    mx, my = _blur(x), _blur(y)
    sx, sy = _blur(x * x) - mx * mx, _blur(y * y) - my * my
    sxy = _blur(x * y) - mx * my
    similarity = ((2 * mx * my + C1) * (2 * sxy + C2)) / ((mx * mx + my * my + C1) * (sx + sy + C2))
    return similarity[:, 0].movedim(0, -1)


@cache
def window() -> Tensor:
    """The normalised one-dimensional Gaussian window (11,), float64."""
    offset = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weight = torch.exp(-0.5 * (offset / SIGMA) ** 2)
    return weight / weight.sum()


def _blur(planes: Tensor) -> Tensor:
    kernel = window().to(planes)
    half = WINDOW // 2
    rows = functional.conv2d(planes, kernel.view(1, 1, 1, -1), padding=(0, half))
    return functional.conv2d(rows, kernel.view(1, 1, -1, 1), padding=(half, 0))


def _pair(image: ArrayLike | Tensor, reference: ArrayLike | Tensor) -> tuple[Tensor, Tensor]:
    first, second = (torch.as_tensor(one).to(torch.float64) for one in (image, reference))
    if first.shape != second.shape:
        raise ValueError(f"images differ in shape: {tuple(first.shape)}, {tuple(second.shape)}")
    return first, second


@dataclass(frozen=True)
class RegionScore:
    """How alike two images are in some pixels.

    Attributes:
        psnr: dB over the pixels, at most 100.
        ssim: mean SSIM over the pixels, from the map of the whole images.
        lpips: LPIPS; None where no weights are given.
    """

    psnr: float
    ssim: float
    lpips: float | None = None


@dataclass(frozen=True)
class MovingRegion:
    """Where the moving objects of a view are.

    Attributes:
        mask: (H, W) bool, the union of their projected boxes.
        rectangles: rectangles around each box, within the image.
    """

    mask: Mask
    rectangles: tuple[Rectangle, ...]


def moving_tracks(log: DrivingLog) -> dict[str, Track]:
    """The log's tracks that move, by the rule that makes actors of them."""
    return {key: track for key, track in log.tracks.items() if moves(track.trajectory)}


def moving_region(tracks: Mapping[str, Track], view: TrainingView) -> MovingRegion:
    """The pixels inside projected boxes with length and width times 1.5, as labelled.

    What stands before a box is not taken out of it. The region depends on the log alone, so that
    two scenes are scored on the same pixels.
    """
    height, width = view.camera.height, view.camera.width
    mask, rectangles = np.zeros((height, width), np.bool_), []
    for track in tracks.values():
        pose = pose_at(track.trajectory, view.timestamp_us)
        if pose is None:
            continue
        size = track.size * BOX_GROWTH
        outline = box_outline(size, view.camera_from_world @ pose, view.camera)
        if len(outline) < 3:
            continue
        left, top = (int(v) for v in np.clip(np.floor(outline.min(axis=0)), 0, (width, height)))
        right, bottom = (int(v) for v in np.clip(np.ceil(outline.max(axis=0)), 0, (width, height)))
        if left >= right or top >= bottom:
            continue
        inside = (slice(top, bottom), slice(left, right))
        mask[inside] |= _within(outline, left, top, right, bottom)
        rectangles.append((left, top, right, bottom))
    return MovingRegion(mask, tuple(rectangles))


def _within(points: Array, left: int, top: int, right: int, bottom: int) -> Mask:
    """Which pixel centres of a rectangle lie within the convex hull of points (N, 2)."""
    hull = cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64)
    edges = np.roll(hull, -1, axis=0) - hull
    area = np.sum(hull[:, 0] * np.roll(hull[:, 1], -1) - hull[:, 1] * np.roll(hull[:, 0], -1))
    x, y = np.meshgrid(np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5)
    inside = np.ones(x.shape, np.bool_)
    for (x0, y0), (dx, dy) in zip(hull, edges, strict=True):
        inside &= np.sign(area) * (dx * (y - y0) - dy * (x - x0)) >= 0
    return inside


def score_regions(
    rendered: NDArray[np.float32], view: TrainingView, moving: MovingRegion, lpips: Distance | None
) -> tuple[RegionScore, RegionScore | None]:
    """Scores of the whole image and of what moves in it; None where too little does.

    Pixels that are never usable count in neither. LPIPS of what moves is the mean over the
    rectangles around the boxes.

    Args:
        rendered: (H, W, 3) in [0, 1], unusable pixels as recorded.
        view: view with the image to compare with.
    """
    drawn, wanted = rendered.astype(np.float64), view.image.astype(np.float64) / 255
    similarity = ssim_map(torch.from_numpy(drawn), torch.from_numpy(wanted)).numpy()
    usable = np.ones(drawn.shape[:2], np.bool_) if view.mask is None else view.mask

    def score(pixels: Mask, distance: float | None) -> RegionScore:
        likeness = capped_psnr(drawn[pixels], wanted[pixels])
        return RegionScore(likeness, float(similarity[pixels].mean()), distance)

    whole = score(usable, None if lpips is None else lpips(drawn, wanted))
    inside = moving.mask & usable
    if int(inside.sum()) < MIN_MOVING_PX:
        return whole, None
    around = None if lpips is None else _around(lpips, drawn, wanted, moving.rectangles)
    return whole, score(inside, around)


def capped_psnr(image: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """PSNR in dB, 100 for equal pixels."""
    return min(psnr(image, reference), PSNR_CAP)


def mean_score(scores: Sequence[RegionScore]) -> RegionScore | None:
    """The mean of each measure; None of nothing."""
    if not scores:
        return None
    distances = [score.lpips for score in scores if score.lpips is not None]
    return RegionScore(
        psnr=float(np.mean([score.psnr for score in scores])),
        ssim=float(np.mean([score.ssim for score in scores])),
        lpips=float(np.mean(distances)) if distances else None,
    )


def _around(lpips: Distance, drawn: Array, wanted: Array, rectangles: Sequence[Rectangle]) -> float:
    found = []
    for left, top, right, bottom in rectangles:
        rows = _grown(top, bottom, drawn.shape[0])
        columns = _grown(left, right, drawn.shape[1])
        found.append(lpips(drawn[rows, columns], wanted[rows, columns]))
    return float(np.mean(found))


def _grown(first: int, last: int, limit: int) -> slice:
    """An interval as long as `LPIPS_SIDE` at least, within 0 and `limit`."""
    length = min(max(last - first, LPIPS_SIDE), limit)
    start = min(max((first + last - length) // 2, 0), limit - length)
    return slice(start, start + length)


@dataclass(frozen=True)
class DepthScore:
    """Depth along the camera's axis against LiDAR points, metres.

    Attributes:
        points: LiDAR points compared.
        missing: share of the points in whose pixel the scene is open sky; not in the errors.
        median_abs_m, mean_abs_m: median and mean of |rendered - measured|, metres.
        mean_relative: mean of |rendered - measured| / measured.
        lag_ms: mean time between image and sweep, milliseconds. Training kept its hands off sweeps
            within 20 ms of a held-out image; others it has seen.
    """

    points: int
    missing: float
    median_abs_m: float
    mean_abs_m: float
    mean_relative: float
    lag_ms: float


class SweepsOfImages:
    """The sweep of each LiDAR that is nearest in time to an image.

    A sweep is read once for all cameras of its moment, as long as they are asked for in order of
    time: the last one of each LiDAR is kept.

    Args:
        actors: tracks whose points are told from the street's.
    """

    def __init__(self, log: DrivingLog, actors: Mapping[str, Track]) -> None:
        self._log, self._actors = log, actors
        self._kept: dict[str, tuple[int, list[OwnedSweep]]] = {}

    def at(self, timestamp_us: int) -> list[OwnedSweep]:
        """Those within `SWEEP_REACH_US` of an image, one of each LiDAR at most, by time."""
        found: list[OwnedSweep] = []
        for stream in self._log.lidars.values():
            if len(stream.timestamps_us) == 0:
                continue
            index = int(np.argmin(np.abs(stream.timestamps_us - timestamp_us)))
            if abs(int(stream.timestamps_us[index]) - timestamp_us) <= SWEEP_REACH_US:
                found += self._read(stream, index)
        return sorted(found, key=lambda sweep: sweep.timestamp_us)

    def _read(self, stream: LidarStream, index: int) -> list[OwnedSweep]:
        kept = self._kept.get(stream.name)
        if kept is None or kept[0] != index:
            own = replace(
                stream,
                timestamps_us=stream.timestamps_us[[index]],
                sweeps=[stream.sweeps[index]],
            )
            log = replace(self._log, lidars={stream.name: own})
            kept = (index, read_sweeps(log, self._actors, held_out_us=()))
            self._kept[stream.name] = kept
        return kept[1]


def depth_score(
    rendered: SceneImage,
    view: TrainingView,
    sweeps: Sequence[OwnedSweep],
    actors: Mapping[str, Track],
) -> DepthScore | None:
    """Score the expected depth, sum of T alpha z / alpha, in the pixels of LiDAR points.

    Points of moving objects are carried with their box to the view's time; points hidden from the
    camera are left out. From 1 m to 100 m.

    Args:
        rendered: image drawn from the view's pose.
        actors: the tracks that the sweeps were divided by.

    Returns:
        None where no point is seen, or the scene has a surface at none of them.
    """
    samples = depth_samples(view, sweeps, actors, window_us=SWEEP_REACH_US)
    columns, rows = np.floor(samples.uv).astype(np.int64).T
    alpha = rendered.alpha[rows, columns]
    lags = [abs(sweep.timestamp_us - view.timestamp_us) for sweep in sweeps]
    covered = alpha >= SURFACE_ALPHA
    if not covered.any():
        return None
    measured = samples.depths[covered].astype(np.float64)
    error = np.abs(rendered.depth[rows, columns][covered] / alpha[covered] - measured)
    return DepthScore(
        points=len(samples.depths),
        missing=float(np.mean(~covered)),
        median_abs_m=float(np.median(error)),
        mean_abs_m=float(np.mean(error)),
        mean_relative=float(np.mean(error / measured)),
        lag_ms=float(np.mean(lags)) / 1000,
    )


def mean_depth(scores: Sequence[DepthScore]) -> DepthScore | None:
    """Means over images, and all their points; None of nothing."""
    if not scores:
        return None
    points, *columns = zip(*(astuple(score) for score in scores), strict=True)
    return DepthScore(sum(points), *(float(np.mean(column)) for column in columns))
