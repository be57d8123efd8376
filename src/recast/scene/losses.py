"""What a step minimises: a view against the recorded one, and what keeps a scene plausible.

Of a view, `alpha` (H, W) is the accumulated opacity; `sky` (S,) and `ground` (G,) are int64 flat
indices of pixels that are surely sky, and surely none.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Literal

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Float32Array
from recast.geometry import boxes
from recast.scene.config import SceneConfig
from recast.scene.levels import Level
from recast.scene.poses import TrackPoses
from recast.scene.scores import C1, C2, WINDOW, ssim_map, window
from recast.scene.trainable import Drawn, rows
from recast.splats import Gaussians, Rasterization, rasterize

DepthError = Literal["relative", "metric", "inverse"]

NEAREST_M = 0.5
"""Inverse depths are compared no nearer than this: rays that meet nothing have depth 0."""
SHARPEST = 10.0
"""Longest to shortest axis of a Gaussian that costs nothing (OmniRe)."""
SHARP_SHAPE_EVERY = 10
"""Steps between the costs of sharp shapes (OmniRe)."""
SMOOTH_OVER = 5
"""Track positions are compared with those up to this many labels before and after (OmniRe)."""


class _Photometric(torch.autograd.Function):
    """Value and gradient in one sweep of separable filters on interleaved float32 images."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, ssim_weight: float, slabs: int) -> Tensor:
        x, y = image.detach().numpy(), target.numpy()
        gradient = np.empty_like(x)
        edges = np.linspace(0, len(x), slabs + 1).astype(int)

        def run(slab: int) -> float:
            return _photometric_rows(x, y, gradient, edges[slab], edges[slab + 1], ssim_weight)

        parts = map(run, range(slabs)) if slabs == 1 else _pool(slabs).map(run, range(slabs))
        ctx.gradient = torch.from_numpy(gradient)
        return image.new_tensor(sum(parts) / x.size)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None, None, None]:
        return ctx.gradient * grad_outputs[0], None, None, None


def photometric_loss(
    image: Tensor, target: Tensor, ssim_weight: float = 0.2, threads: int = 1
) -> Tensor:
    """(1 - w) mean |x - y| + w (1 - mean SSIM) of float32 images (H, W, 3) in [0, 1].

    Zhao et al. 2017 as used by 3D Gaussian splatting (eq. 7). Differentiable in `image` only. Fused
    on the CPU; on another device it is torch's own kernels, by the plain twin `scores.ssim_map`.
    """
    if image.device.type != "cpu":
        similarity = ssim_map(image, target).mean()
        return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - similarity)
    return _Photometric.apply(image.contiguous(), target.contiguous(), ssim_weight, threads)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)


def _blur(image: Float32Array) -> Float32Array:
    kernel = window().numpy().astype(np.float32)
    blurred = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, np.float32)


def _photometric_rows(
    image: Float32Array,
    target: Float32Array,
    gradient: Float32Array,
    first: int,
    last: int,
    ssim_weight: float,
) -> float:
    """Fill rows [first, last) of the gradient of the mean loss; return the rows' sum of the loss.

    With S = A B / (C D), A = 2 mx my + C1, B = 2 sxy + C2, C = mx^2 + my^2 + C1, D = sx + sy + C2,
    the moments of x enter S through mx, blur(x^2), blur(x y); the window is symmetric, so the
    adjoint of a blur is the same blur. Two blurs in a row need a halo of two half windows.
    """
    halo = 2 * (WINDOW // 2)
    top, bottom = max(0, first - halo), min(len(image), last + halo)
    inner = slice(first - top, last - top)
    x, y = image[top:bottom], target[top:bottom]
    difference = x[inner] - y[inner]
    loss = (1 - ssim_weight) * float(np.abs(difference).sum(dtype=np.float32))
    weight = np.float32((1 - ssim_weight) / image.size)
    np.copysign(weight, difference, out=gradient[first:last])
    if ssim_weight == 0:
        return loss

    mx, my = _blur(x), _blur(y)
    d = _blur(x * x + y * y)  # the variances enter only as their sum
    b = _blur(x * y)
    mxy = mx * my
    c = mx * mx
    c += my * my
    d -= c
    d += np.float32(C2)
    c += np.float32(C1)
    b -= mxy
    b *= 2
    b += np.float32(C2)
    mxy *= 2
    mxy += np.float32(C1)
    a = mxy
    inverse = c * d
    np.divide(np.float32(2 * ssim_weight / image.size), inverse, out=inverse)
    by_cross = a * inverse
    s = by_cross * b
    s *= 0.5
    by_energy = s / d
    by_mean = b
    by_mean -= a
    by_mean *= my
    by_mean *= inverse
    s /= c
    np.subtract(by_energy, s, out=s)
    s *= 2
    s *= mx
    by_mean += s
    similarity = by_energy[inner] * d[inner]
    out = gradient[first:last]
    out -= _blur(by_mean)[inner]
    energy_term = _blur(by_energy)[inner]
    energy_term *= 2
    energy_term *= x[inner]
    out += energy_term
    cross_term = _blur(by_cross)[inner]
    cross_term *= y[inner]
    out -= cross_term
    total = float(similarity.sum(dtype=np.float32)) * image.size
    return loss + ssim_weight * similarity.size - total


def depth_loss(
    depth: Tensor,
    alpha: Tensor,
    pixels: Tensor,
    measured: Tensor,
    keep: float = 0.95,
    error: DepthError = "relative",
) -> Tensor:
    """Mean error of the expected depth e = D / (alpha + 1e-10) at measured pixels z.

    The largest errors are dropped: at 0.95 the worst 5 %, which are moving things and edges that
    the laser saw from another place (Street Gaussians' trimming).

    Args:
        depth, alpha: (H, W) as rendered, depth not normalised.
        pixels: (M,) int64 flat pixel indices.
        measured: (M,) metres along the camera's z axis.
        keep: share of the smallest errors that count.
        error: "relative" |e - z| / z, "metric" |e - z| in metres, "inverse" |1 / e - 1 / z|, where
            e counts as at least `NEAREST_M`.
    """
    if len(pixels) == 0:
        return depth.new_zeros(())
    weight = alpha.reshape(-1)[pixels]
    expected = depth.reshape(-1)[pixels] / (weight + 1e-10)
    if error == "inverse":
        errors = (1 / expected.clamp(min=NEAREST_M) - 1 / measured).abs()
    else:
        errors = (expected - measured).abs()
        if error == "relative":
            errors = errors / measured
    count = max(1, int(keep * len(errors)))
    if count < len(errors):
        errors = errors.topk(count, largest=False, sorted=False).values
    return errors.mean()


def sky_loss(alpha: Tensor, sky: Tensor) -> Tensor:
    """Mean accumulated opacity of the sky pixels, as a share of the whole image.

    Args:
        alpha, sky: (H, W) accumulated opacity; (S,) int64 flat indices of pixels known to be sky.
    """
    return alpha.reshape(-1)[sky].sum() / alpha.numel()


def sky_entropy(alpha: Tensor, sky: Tensor, ground: Tensor) -> Tensor:
    """Binary cross entropy of opacity, as a share of the whole image: 0 on sky, 1 on the ground.

    -ln(1 - a) on sky pixels, at least 1e-6 from either end, and `solid_loss` on the ground; pixels
    in neither set do not count. Street Gaussians and OmniRe have every pixel in one of them.

    Args:
        alpha: (H, W) accumulated opacity.
        sky, ground: (S,) and (G,) int64 flat indices.
    """
    a = alpha.reshape(-1).clamp(1e-6, 1 - 1e-6)
    return solid_loss(alpha, ground) - (1 - a[sky]).log().sum() / alpha.numel()


def solid_loss(alpha: Tensor, ground: Tensor) -> Tensor:
    """-ln a, a at least 1e-6, summed over pixels where something is, as a share of the whole image.

    Else the sky may show through a road and lend it colour, which seen from beside is wrong.

    Args:
        alpha, ground: (H, W) accumulated opacity; (G,) int64 flat indices.
    """
    a = alpha.reshape(-1)[ground].clamp(min=1e-6)
    return -a.log().sum() / alpha.numel()


def view_loss(
    config: SceneConfig, image: Tensor, result: Rasterization, level: Level, threads: int
) -> Tensor:
    """The weighted sum of photometric, depth, sky and opacity loss.

    Args:
        image: (H, W, 3) composited of `result`, unusable pixels black.
    """
    loss = photometric_loss(image, level.target, config.ssim_weight, threads)
    if config.depth_weight > 0:
        drawn, measured = (result.depth, result.alpha), (level.depth_pixels, level.depths)
        depth = depth_loss(*drawn, *measured, config.depth_keep, config.depth_error)
        loss = loss + config.depth_weight * depth
    if config.sky_weight > 0:
        if config.sky_loss == "entropy":
            sky = sky_entropy(result.alpha, level.sky, level.ground)
        else:
            sky = sky_loss(result.alpha, level.sky)
        loss = loss + config.sky_weight * sky
    if config.solid_weight > 0:
        loss = loss + config.solid_weight * solid_loss(result.alpha, level.ground)
    return loss


def actors_alone(
    drawn: Drawn, pose: Tensor, level: Level, placed: Sequence[tuple[Array, Tensor]]
) -> Tensor:
    """`actor_opacity` of a view's actors, rendered a second time without the rest.

    Args:
        pose: (4, 4) camera_from_world.
        placed: size (3,) and `world_from_actor` (4, 4) of each actor that is drawn.
    """
    if not drawn.spans:
        return pose.new_zeros(())
    first, camera = drawn.spans[0].first, level.camera
    own = Gaussians(**{name: value[first:] for name, value in rows(drawn.gaussians).items()})
    alpha = rasterize(own, pose, level.K, camera.width, camera.height).alpha
    camera_from_world = pose.detach().double().cpu().numpy()
    inside = np.zeros((camera.height, camera.width), bool)
    for size, world_from_actor in placed:
        box = camera_from_world @ world_from_actor.detach().double().cpu().numpy()
        rectangle = boxes.project(size, box, camera)
        if rectangle is not None:
            left, top = np.floor(np.maximum(rectangle[:2], 0)).astype(int)
            right, bottom = np.ceil(np.maximum(rectangle[2:], 0)).astype(int)
            inside[top:bottom, left:right] = True
    return actor_opacity(alpha, torch.from_numpy(inside).to(alpha.device))


def sharp_shape(log_scales: Tensor) -> Tensor:
    """mean(max(longest / shortest axis, 10) - 10) of (N, 3) log scales: needles make streaks."""
    ratio = (log_scales.amax(dim=1) - log_scales.amin(dim=1)).exp()
    return (ratio - SHARPEST).clamp(min=0).mean()


def actor_opacity(alpha: Tensor, inside: Tensor) -> Tensor:
    """Opacity of the actors alone: all or nothing in their boxes, nothing beside them.

    Street Gaussians' object term: -(a ln a + (1 - a) ln(1 - a)) inside, -ln(1 - a) outside, mean
    over the image.

    Args:
        alpha: (H, W) of actors rendered without the background.
        inside: (H, W) bool, in an actor's box.
    """
    a = alpha.clamp(1e-6, 1 - 1e-6)
    empty = -(1 - a).log()
    return torch.where(inside, -a * a.log() + (1 - a) * empty, empty).mean()


class TrackSmoothness:
    """How far tracks are from even motion: |x(t + k) + x(t - k) - 2 x(t)| for k = 1..5 labels.

    Labels are not all evenly spaced (held-out ones are missing), so the middle is compared with the
    place at its own time between the two others.
    """

    def __init__(self, poses: TrackPoses) -> None:
        self._poses = poses
        starts, middles, ends, weights = [], [], [], []
        positions = [np.zeros((0, 3))]
        for row, times, logged in poses.knots():
            positions.append(logged)
            for k in range(1, SMOOTH_OVER + 1):
                middle = np.arange(k, len(times) - k)
                before, after = times[middle - k], times[middle + k]
                starts.append(row + middle - k)
                middles.append(row + middle)
                ends.append(row + middle + k)
                weights.append((times[middle] - before) / (after - before))
        self._positions = torch.from_numpy(np.concatenate(positions))
        none = [np.zeros(0, np.int64)]
        self._start, self._middle, self._end = (
            torch.from_numpy(np.concatenate(none + part)) for part in (starts, middles, ends)
        )
        self._weight = torch.from_numpy(np.concatenate([np.zeros(0), *weights]))[:, None]

    def loss(self) -> Tensor:
        """Mean over labels and k, metres; 0 without a track of three labels."""
        if len(self._middle) == 0:
            return torch.zeros(())
        x = self._positions + self._poses.table.value[:, :3].double()
        between = torch.lerp(x[self._start], x[self._end], self._weight)
        return 2 * (between - x[self._middle]).abs().sum(dim=1).mean().float()
