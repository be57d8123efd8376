"""A track's vehicle at its logged poses in held-out images: several models of it side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from recast.evaluation.oracle_scores import PSNR_CAP, Rectangle, grown
from recast.logs import DrivingLog
from recast.scene import SceneConfig, SceneRasterizer, StreetScene, psnr
from recast.scene.dynamic import box_rectangle, pose_at
from recast.scene.evaluate_views import MIN_BOX_PX, draw_view
from recast.scene.image_metrics import ssim_map
from recast.scene.views import View, camera_names, is_held_out, read_view

Image = NDArray[np.uint8]

_MARGIN = 24  # pixels around the box: more than half an SSIM window, and to look at
_GAP = 4


@dataclass(frozen=True)
class TrackView:
    """One held-out image of a track.

    Attributes:
        camera, frame, timestamp_us: of the image.
        rectangle: of the box, whole pixels.
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
        config: of the scenes' training: cameras, scale and split.
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
            outline = box_rectangle(own.size, pose, view)
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
    view: View, rectangle: Rectangle, images: Mapping[str, NDArray[np.float64]]
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
        psnr={m: min(psnr(image[inside], truth[inside]), PSNR_CAP) for m, image in images.items()},
        ssim={model: float(found[inner].mean()) for model, found in similarity.items()},
        picture=(np.concatenate(tiles, axis=1).clip(0, 1) * 255).round().astype(np.uint8),
    )
