"""How alike a drawn vehicle and its photograph are: without background, and in held-out images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from recast.arrays import Array, Image, Mask
from recast.logs import DrivingLog
from recast.metrics.cases import ActorView
from recast.metrics.oracle_scores import grown, mask_iou
from recast.metrics.perceptual import ImageDistance
from recast.reconstruction import SceneConfig, ssim
from recast.reconstruction.evaluate import MIN_BOX_PX, draw_view
from recast.reconstruction.scores import Rectangle, capped_psnr, ssim_map
from recast.reconstruction.views import (
    TrainingView,
    camera_names,
    is_held_out,
    read_view,
    visible_rectangle,
)
from recast.scene import SceneRasterizer, StreetScene
from recast.scene.actor import draw
from recast.scene.poses import pose_at
from recast.splats import Gaussians, LowPass

_MARGIN = 24  # pixels around the box: more than half an SSIM window, and to look at
_GAP = 4


@dataclass(frozen=True)
class ActorColumn:
    """How a score is shown.

    Attributes:
        higher: whether a higher one is better.
    """

    label: str
    unit: str
    higher: bool
    decimals: int

    def shown(self, value: float) -> str:
        """The score in text."""
        return f"{value:.{self.decimals}f}"


ACTOR_COLUMNS: Mapping[str, ActorColumn] = {
    "psnr": ActorColumn("PSNR", "dB", True, 2),
    "psnr_vehicle": ActorColumn("PSNR vehicle", "dB", True, 2),
    "ssim": ActorColumn("SSIM", "", True, 4),
    "mask_iou": ActorColumn("mask IoU", "", True, 3),
    "lpips": ActorColumn("LPIPS", "", False, 4),
    "clip": ActorColumn("CLIP image", "x100", True, 2),
    "dino": ActorColumn("DINO distance", "", False, 4),
}
"""Scores in the order of the table; the last three only where weights were given."""


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels; it may reach beyond the image.

    Attributes:
        top, left: row and column of its first pixel; negative above and left of the image.
        height, width: size in pixels.
    """

    top: int
    left: int
    height: int
    width: int

    def of(self, image: Array) -> Array:
        """What an image (H, W, ...) shows in the window (height, width, ...); zeros beyond it."""
        seen = np.zeros((self.height, self.width, *image.shape[2:]), image.dtype)
        bottom, right = self.top + self.height, self.left + self.width
        part = image[max(self.top, 0) : max(bottom, 0), max(self.left, 0) : max(right, 0)]
        top, left = max(-self.top, 0), max(-self.left, 0)
        seen[top : top + part.shape[0], left : left + part.shape[1]] = part
        return seen


@dataclass(frozen=True)
class ScoredCutout:
    """A vehicle before black.

    Attributes:
        rgb: (H, W, 3) float64 display values in [0, 1], multiplied by alpha.
        alpha: (H, W) float64 in [0, 1].
    """

    rgb: Array
    alpha: Array

    @property
    def mask(self) -> Mask:
        """(H, W) pixels covered by more than half."""
        return self.alpha > 0.5

    def before(self, grey: float) -> Array:
        """(H, W, 3) with that grey behind it."""
        return np.clip(self.rgb + (1 - self.alpha[..., None]) * grey, 0.0, 1.0)

    def within(self, window: Window) -> ScoredCutout:
        """The part in a window; beyond the image there is nothing, as around the vehicle."""
        return ScoredCutout(window.of(self.rgb), window.of(self.alpha))


def photographed(rgba: NDArray[np.uint8]) -> ScoredCutout:
    """A picture (H, W, 4) with straight alpha as a cutout."""
    alpha = rgba[..., 3].astype(np.float64) / 255
    return ScoredCutout(rgba[..., :3] / 255 * alpha[..., None], alpha)


def drawn(gaussians: Gaussians, low_pass: LowPass, view: ActorView) -> ScoredCutout:
    """Gaussians in the actor frame as the camera of a view sees them, by their own filter."""
    with torch.no_grad():
        picture = draw(gaussians, view.camera_from_actor, view.camera, low_pass)
    return ScoredCutout(
        picture.rgb.clamp(0, 1).numpy().astype(np.float64),
        picture.alpha.clamp(0, 1).numpy().astype(np.float64),
    )


def score_view(
    shown: ScoredCutout, truth: ScoredCutout, distances: Sequence[ImageDistance] = ()
) -> dict[str, float]:
    """Scores by key of `ACTOR_COLUMNS`.

    PSNR and SSIM are those of the whole image before black; PSNR of the vehicle is that over the
    pixels of either mask. PSNR is at most 100 dB.

    Args:
        shown, truth: render and photograph of one size.
        distances: further measures, each under its own key.
    """
    either = shown.mask | truth.mask
    scores = {
        "psnr": capped_psnr(shown.rgb, truth.rgb),
        "psnr_vehicle": capped_psnr(shown.rgb[either], truth.rgb[either]),
        "ssim": ssim(shown.rgb, truth.rgb),
        "mask_iou": mask_iou(shown.mask, truth.mask),
    }
    for distance in distances:
        window = framed(truth.mask) if distance.framed else Window(0, 0, *truth.mask.shape)
        scores[distance.key] = distance(window.of(shown.rgb), window.of(truth.rgb))
    return scores


def framed(mask: Mask, margin: float = 0.1) -> Window:
    """A square around a mask (H, W), whole even where the mask reaches the image's edge.

    Args:
        mask: mask with at least one pixel.
        margin: share of the mask's longer side left free on every side.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    low = np.array([rows[0], columns[0]])
    high = np.array([rows[-1], columns[-1]]) + 1
    side = int(np.ceil(np.max(high - low) * (1 + 2 * margin)))
    top, left = np.floor((low + high - side) / 2).astype(int)
    return Window(int(top), int(left), side, side)


def mean_scores(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of every score over views, or over vehicles; all have the same keys."""
    return {key: float(np.mean([one[key] for one in scores])) for key in scores[0]}


@dataclass(frozen=True)
class TrackView:
    """One held-out image of a track.

    Attributes:
        rectangle: rectangle of the box, whole pixels.
        psnr: dB in the rectangle by model, at most 100.
        ssim: mean over the rectangle by model.
        picture: (H, W, 3) box and margin: the recording, then each model.
    """

    camera: str
    frame: int
    timestamp_us: int
    rectangle: Rectangle
    psnr: dict[str, float]
    ssim: dict[str, float]
    picture: Image


def held_out_track(
    log: DrivingLog, track_id: str, config: SceneConfig, models: Mapping[str, StreetScene]
) -> Iterator[TrackView]:
    """Score the held-out images that show a track well enough, in which nothing is moved.

    Args:
        config: configuration of the scenes' training: cameras, scale and split.
        models: scenes by name, each with a model of the track. The first one's poses say where the
            box is.

    Yields:
        an image after the other, camera by camera.
    """
    rasterizers = {name: SceneRasterizer(scene) for name, scene in models.items()}
    own = next(iter(models.values())).actors[track_id]
    for name in camera_names(log, config):
        stream = log.cameras[name]
        for frame in range(len(stream.timestamps_us)):
            pose = pose_at(own.trajectory, int(stream.timestamps_us[frame]))
            if pose is None or not is_held_out(frame, config):
                continue
            view = read_view(log, stream, frame, config.scale, held_out=True)
            outline = visible_rectangle(own.size, pose, view)
            if outline is None or min(outline[2:] - outline[:2]) < MIN_BOX_PX:
                continue
            left, top = np.floor(outline[:2]).astype(int).tolist()
            right, bottom = np.ceil(outline[2:]).astype(int).tolist()
            images = {
                model: draw_view(rasterizers[model], scene, view).rgb.astype(np.float64)
                for model, scene in models.items()
            }
            yield _scored(view, (left, top, right, bottom), images)


def _scored(
    view: TrainingView, rectangle: Rectangle, images: Mapping[str, NDArray[np.float64]]
) -> TrackView:
    truth = view.image.astype(np.float64) / 255
    left, top, right, bottom = rectangle
    inside = (slice(top, bottom), slice(left, right))
    outer = grown(rectangle, _MARGIN, view.camera.width, view.camera.height)
    window = (slice(outer[1], outer[3]), slice(outer[0], outer[2]))
    inner = tuple(
        slice(part.start - whole.start, part.stop - whole.start)
        for part, whole in zip(inside, window, strict=True)
    )
    similarity = {
        model: ssim_map(torch.from_numpy(image[window]), torch.from_numpy(truth[window]))
        for model, image in images.items()
    }
    gap = np.ones((outer[3] - outer[1], _GAP, 3))
    tiles = [truth[window]]
    for image in images.values():
        tiles += [gap, image[window]]
    return TrackView(
        camera=view.camera_name,
        frame=view.frame,
        timestamp_us=view.timestamp_us,
        rectangle=rectangle,
        psnr={m: capped_psnr(image[inside], truth[inside]) for m, image in images.items()},
        ssim={model: float(found[inner].mean()) for model, found in similarity.items()},
        picture=(np.concatenate(tiles, axis=1).clip(0, 1) * 255).round().astype(np.uint8),
    )
