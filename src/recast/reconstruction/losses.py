"""What a step minimises: a view against the recorded one, and what keeps a scene plausible.

Of a view, `alpha` (H, W) is the accumulated opacity; `sky` (S,) and `ground` (G,) are int64 flat
indices of pixels that are surely sky, and surely none.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.arrays import Array
from recast.cameras import box_rectangle
from recast.kernel import Photometric, library
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.scores import C1, C2, WINDOW, ssim_map, window
from recast.reconstruction.tables import TrackPoses
from recast.reconstruction.views import Level
from recast.splats import Gaussians, Rasterization, rasterize
from recast.splats.native.rasterizer import empty, takes

DepthError = Literal["relative", "metric", "inverse"]


NEAREST_M = 0.5
"""Inverse depths are compared no nearer than this: rays that meet nothing have depth 0."""


SHARPEST = 10.0
"""Longest to shortest axis of a Gaussian that costs nothing (OmniRe)."""


SHARP_SHAPE_EVERY = 10
"""Steps between the costs of sharp shapes (OmniRe)."""


SMOOTH_OVER = 5
"""Track positions are compared with those up to this many labels before and after (OmniRe)."""


@dataclass(frozen=True)
class Span:
    """Rows of one present actor: `[first, last)` as drawn, `[start, stop)` among all actors' rows.

    Attributes:
        posed: its Gaussians in the world, with the graph back to the parameters and the pose.
    """

    first: int
    last: int
    start: int
    stop: int
    posed: Gaussians


@dataclass(frozen=True)
class DrawnView:
    """What one view sees: leaf Gaussians for the rasterizer, and where the actors are in them."""

    gaussians: Gaussians
    spans: tuple[Span, ...]


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


def view_loss(config: SceneConfig, image: Tensor, result: Rasterization, level: Level) -> Tensor:
    """The weighted sum of photometric, depth, sky and opacity loss.

    Args:
        image: (H, W, 3) composited of `result`, unusable pixels black.
    """
    loss = photometric_loss(image, level.target, config.ssim_weight)
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
    drawn: DrawnView, pose: Tensor, level: Level, placed: Sequence[tuple[Array, Tensor]]
) -> Tensor:
    """`actor_opacity` of a view's actors, rendered a second time without the rest.

    Args:
        pose: (4, 4) camera_from_world.
        placed: size (3,) and `world_from_actor` (4, 4) of each actor that is drawn.
    """
    if not drawn.spans:
        return pose.new_zeros(())
    first, camera = drawn.spans[0].first, level.camera
    own = Gaussians(**{name: value[first:] for name, value in vars(drawn.gaussians).items()})
    alpha = rasterize(own, pose, level.K, camera.width, camera.height).alpha
    camera_from_world = pose.detach().double().cpu().numpy()
    inside = np.zeros((camera.height, camera.width), bool)
    for size, world_from_actor in placed:
        box = camera_from_world @ world_from_actor.detach().double().cpu().numpy()
        rectangle = box_rectangle(size, box, camera)
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
        alpha: (H, W) opacity of actors rendered without the background.
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


def photometric_loss(image: Tensor, target: Tensor, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) mean |x - y| + w (1 - mean SSIM) of images (H, W, 3) in [0, 1].

    Zhao et al. 2017 as used by 3D Gaussian splatting (eq. 7). Differentiable in `image` only. The
    compiled kernel does it for float32 on the CPU; elsewhere, and where there is none, it is
    `photometric_reference`.

    Raises:
        ValueError: the images are not of one shape (H, W, 3).
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        shapes = f"{tuple(image.shape)} and {tuple(target.shape)}"
        raise ValueError(f"photometric_loss: images {shapes}, expected one shape (H, W, 3)")
    if takes(image, target):
        return _Fused.apply(image.contiguous(), target.contiguous(), ssim_weight)
    return photometric_reference(image, target.detach(), ssim_weight)


def photometric_reference(image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
    """`photometric_loss` in torch, for any device and type."""
    similarity = ssim_map(image, target).mean()
    return (1 - ssim_weight) * (image - target).abs().mean() + ssim_weight * (1 - similarity)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
        maps = [empty(*image.shape) for _ in range(3)]
        sums = torch.empty(image.shape[0], 2, dtype=torch.float64)
        call = _call(image, target, maps)
        call.sums = sums.data_ptr()
        library().recast_photometric(ctypes.byref(call))
        ctx.save_for_backward(image, target, *maps)
        ctx.ssim_weight = ssim_weight
        difference, similarity = (sums.sum(dim=0) / image.numel()).tolist()
        return image.new_tensor((1 - ssim_weight) * difference + ssim_weight * (1 - similarity))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, loss_grad: Tensor) -> tuple[Tensor, None, None]:
        image, target, *maps = ctx.saved_tensors
        gradient = empty(*image.shape)
        call = _call(image, target, maps)
        factor = float(loss_grad) / image.numel()
        call.gradient = gradient.data_ptr()
        call.l1, call.ssim = (1 - ctx.ssim_weight) * factor, -ctx.ssim_weight * factor
        library().recast_photometric_backward(ctypes.byref(call))
        return gradient, None, None


def _call(image: Tensor, target: Tensor, maps: list[Tensor]) -> Photometric:
    height, width, channels = image.shape
    by_mean, by_square, by_product = (one.data_ptr() for one in maps)
    return Photometric(
        image=image.data_ptr(),
        target=target.data_ptr(),
        by_mean=by_mean,
        by_square=by_square,
        by_product=by_product,
        height=height,
        row=width * channels,
        window=(ctypes.c_float * (WINDOW // 2 + 1))(*window()[: WINDOW // 2 + 1].tolist()),
        c1=C1,
        c2=C2,
    )
