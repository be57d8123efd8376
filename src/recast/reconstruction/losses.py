"""What a step minimises: a view against the recorded one, and what keeps a scene plausible.

Of a view, `alpha` (H, W) is the accumulated opacity; `sky` (S,) and `ground` (G,) are int64 flat
indices of pixels that are surely sky, and surely none.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.arrays import Array
from recast.cameras import box_rectangle
from recast.kernel import Photometric, library
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.scores import C1, C2, WINDOW, ssim_map, window
from recast.reconstruction.settings import OPTIM
from recast.reconstruction.tables import TrackPoses
from recast.reconstruction.views import Level
from recast.splats import Gaussians, Rasterization, rasterize
from recast.splats.native.rasterizer import empty, takes

DepthError = Literal["relative", "metric", "inverse"]


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


@dataclass(frozen=True)
class Drawing:
    """What a step drew of a view: all that a term of the loss may look at.

    Attributes:
        iteration: number of the step, from 0.
        grows: whether density control still goes on.
        image: (H, W, 3) with the sky, exposed as the camera did; unusable pixels black.
        result: rendering without the sky.
        drawn: the Gaussians, and where actors are among them.
        camera_from_world: (4, 4) corrected pose.
        boxes: size (3,) and `world_from_actor` (4, 4) of each actor that was drawn.
        exposure_change: mean absolute change of colours by the exposure; None without exposures.
        tracks: learned poses of the tracks.
    """

    iteration: int
    grows: bool
    image: Tensor
    result: Rasterization
    drawn: DrawnView
    camera_from_world: Tensor
    boxes: Sequence[tuple[Array, Tensor]]
    exposure_change: Tensor | None
    tracks: TrackPoses


class LossTerm(ABC):
    """A summand of the loss. To add one, write a subclass and put it into `LOSS_TERMS`.

    Attributes:
        name: its name in reports of progress.
        prior: whether it judges the scene alone, not against the recorded view.
    """

    name: ClassVar[str]
    prior: ClassVar[bool] = False

    def __init__(self, config: SceneConfig) -> None:
        self.config = config

    @property
    @abstractmethod
    def weight(self) -> float:
        """Factor of the value, from the settings; a term of weight 0 is not computed."""

    def applies(self, drawing: Drawing) -> bool:
        """Whether the term counts in this step."""
        del drawing
        return True

    @abstractmethod
    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """Scalar, differentiable in what was drawn.

        Args:
            view: the recorded view, its depths and masks.
        """


class PhotometricTerm(LossTerm):
    """L1 and SSIM of the image."""

    name = "photometric"
    weight = 1.0

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `photometric_loss`."""
        return photometric_loss(drawing.image, view.target, self.config.ssim_weight)


class DepthTerm(LossTerm):
    """Depths at LiDAR returns."""

    name = "depth"

    @property
    def weight(self) -> float:
        """`depth_weight`."""
        return self.config.depth_weight

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `depth_loss`."""
        rendered, measured = drawing.result, (view.depth_pixels, view.depths)
        how = self.config.depth_keep, self.config.depth_error
        return depth_loss(rendered.depth, rendered.alpha, *measured, *how)


class SkyTerm(LossTerm):
    """No opacity in front of the sky; with `sky_loss` "entropy", full opacity elsewhere."""

    name = "sky"

    @property
    def weight(self) -> float:
        """`sky_weight`."""
        return self.config.sky_weight

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `sky_loss` and `sky_entropy`."""
        if self.config.sky_loss == "entropy":
            return sky_entropy(drawing.result.alpha, view.sky, view.ground)
        return sky_loss(drawing.result.alpha, view.sky)


class SolidTerm(LossTerm):
    """Full opacity at LiDAR returns."""

    name = "solid"

    @property
    def weight(self) -> float:
        """`solid_weight`."""
        return self.config.solid_weight

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `solid_loss`."""
        return solid_loss(drawing.result.alpha, view.ground)


class ExposureTerm(LossTerm):
    """Small changes of an image's colours."""

    name, prior = "exposure", True

    @property
    def weight(self) -> float:
        """`exposure_weight`."""
        return self.config.exposure_weight

    def applies(self, drawing: Drawing) -> bool:
        """With exposures."""
        return drawing.exposure_change is not None

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """Mean absolute change."""
        assert drawing.exposure_change is not None  # else it does not apply
        return drawing.exposure_change


class SharpShapeTerm(LossTerm):
    """No needles, which make streaks."""

    name, prior = "sharp_shape", True

    @property
    def weight(self) -> float:
        """`sharp_shape_weight`."""
        return self.config.sharp_shape_weight

    def applies(self, drawing: Drawing) -> bool:
        """Every `sharp_shape_every` steps."""
        return drawing.iteration % OPTIM.sharp_shape_every == 0

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `sharp_shape`."""
        return sharp_shape(drawing.drawn.gaussians.log_scales)


class TrackSmoothnessTerm(LossTerm):
    """Even motion of the tracks."""

    name, prior = "track_smoothness", True

    @property
    def weight(self) -> float:
        """`track_smoothness_weight`."""
        return self.config.track_smoothness_weight

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """See `TrackPoses.unevenness`."""
        return drawing.tracks.unevenness().to(drawing.image.device)


class ActorOpacityTerm(LossTerm):
    """Actors that are opaque in their boxes and absent beside them."""

    name, prior = "actor_opacity", True

    @property
    def weight(self) -> float:
        """`actor_opacity_weight`."""
        return self.config.actor_opacity_weight

    def applies(self, drawing: Drawing) -> bool:
        """After densification."""
        return not drawing.grows

    def value(self, drawing: Drawing, view: Level) -> Tensor:
        """`actor_opacity` of a view's actors, rendered a second time without the rest."""
        drawn, pose, camera = drawing.drawn, drawing.camera_from_world, view.camera
        if not drawn.spans:
            return pose.new_zeros(())
        first = drawn.spans[0].first
        own = Gaussians(**{name: part[first:] for name, part in vars(drawn.gaussians).items()})
        alpha = rasterize(
            own,
            pose,
            view.K,
            camera.width,
            camera.height,
            eps2d=self.config.low_pass.variance,
            antialiased=self.config.low_pass.antialiased,
        ).alpha
        camera_from_world = pose.detach().double().cpu().numpy()
        inside = np.zeros((camera.height, camera.width), bool)
        for size, world_from_actor in drawing.boxes:
            box = camera_from_world @ world_from_actor.detach().double().cpu().numpy()
            rectangle = box_rectangle(size, box, camera)
            if rectangle is not None:
                left, top = np.floor(np.maximum(rectangle[:2], 0)).astype(int)
                right, bottom = np.ceil(np.maximum(rectangle[2:], 0)).astype(int)
                inside[top:bottom, left:right] = True
        return actor_opacity(alpha, torch.from_numpy(inside).to(alpha.device))


LOSS_TERMS: list[type[LossTerm]] = [
    PhotometricTerm,
    DepthTerm,
    SkyTerm,
    SolidTerm,
    ExposureTerm,
    SharpShapeTerm,
    TrackSmoothnessTerm,
    ActorOpacityTerm,
]
"""All that a step minimises, in the order in which it is added up."""


def total_loss(
    terms: Sequence[LossTerm], drawing: Drawing, view: Level
) -> tuple[Tensor, dict[str, Tensor]]:
    """The weighted sum of all terms that apply, and each weighted term by name, detached.

    Priors are added up apart: float32 sums depend on their order, to the last bit.
    """
    compared = priors = drawing.image.new_zeros(())
    found = {}
    for term in terms:
        if term.weight == 0 or not term.applies(drawing):
            continue
        weighted = term.weight * term.value(drawing, view)
        found[term.name] = weighted.detach()
        if term.prior:
            priors = priors + weighted
        else:
            compared = compared + weighted
    return compared + priors, found


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
            e counts as at least `nearest_inverse_m`.
    """
    if len(pixels) == 0:
        return depth.new_zeros(())
    weight = alpha.reshape(-1)[pixels]
    expected = depth.reshape(-1)[pixels] / (weight + 1e-10)
    if error == "inverse":
        errors = (1 / expected.clamp(min=OPTIM.nearest_inverse_m) - 1 / measured).abs()
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


def sharp_shape(log_scales: Tensor) -> Tensor:
    """mean(max(longest / shortest axis, 10) - 10) of (N, 3) log scales: needles make streaks."""
    ratio = (log_scales.amax(dim=1) - log_scales.amin(dim=1)).exp()
    return (ratio - OPTIM.sharpest).clamp(min=0).mean()


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
