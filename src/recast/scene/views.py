"""The images of a log as the trainer sees them: rectified, scaled, posed, split."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, Image, Mask
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog
from recast.scene.config import SceneConfig


@dataclass(frozen=True)
class TrainingView:
    """One posed image.

    Attributes:
        camera_name: stream in the log.
        frame: index in that stream.
        timestamp_us: time of the exposure.
        camera: intrinsics of `image`, rectified.
        world_from_camera: (4, 4) as logged.
        image: (H, W, 3) uint8 RGB; (0, 0, 3) where it was not read.
        mask: (H, W) bool, False where the image is never usable, or None.
        held_out: whether the view is kept from training and from everything that leads to it.
    """

    camera_name: str
    frame: int
    timestamp_us: int
    camera: PinholeCamera
    world_from_camera: Array
    image: Image = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    mask: Mask | None = None
    held_out: bool = False

    @property
    def camera_from_world(self) -> Array:
        """(4, 4), as logged."""
        return se3.inverse(self.world_from_camera)


def camera_names(log: DrivingLog, config: SceneConfig) -> tuple[str, ...]:
    """The cameras asked for, or all.

    Raises:
        InputError: a camera that the log does not have, or a log without cameras.
    """
    if not log.cameras:
        raise InputError(log.name, "cameras", "the log has none", "import a log with images")
    for name in config.cameras:
        if name not in log.cameras:
            raise InputError(
                log.name,
                f"camera {name}",
                "is not in the log",
                f"choose one of {sorted(log.cameras)}",
            )
    return config.cameras or tuple(log.cameras)


def is_held_out(frame: int, config: SceneConfig) -> bool:
    """Whether frame `frame` of every camera is kept for evaluation."""
    every = config.holdout_every
    return every > 0 and frame % every == config.holdout_offset % every


def read_places(log: DrivingLog, config: SceneConfig) -> list[TrainingView]:
    """`read_views` without the images: where and when each was taken."""
    return [
        _place(log, log.cameras[name], frame, config.scale, is_held_out(frame, config))
        for name in camera_names(log, config)
        for frame in range(len(log.cameras[name].timestamps_us))
    ]


def read_views(log: DrivingLog, config: SceneConfig) -> list[TrainingView]:
    """All views of the chosen cameras, camera by camera, in order of time.

    A camera's views share one mask: it hangs on lens and mount alone.
    """
    views = []
    for name in camera_names(log, config):
        mask = None
        for frame in range(len(log.cameras[name].timestamps_us)):
            held_out = is_held_out(frame, config)
            view = read_view(log, log.cameras[name], frame, config.scale, held_out)
            mask = view.mask if mask is None else mask
            views.append(replace(view, mask=mask))
    return views


def read_view(
    log: DrivingLog, stream: CameraStream, frame: int, scale: float, held_out: bool = False
) -> TrainingView:
    """Decode, rectify and scale one frame."""
    full = stream.camera
    image: Image = np.ascontiguousarray(stream.images[frame])
    mask = stream.mask
    if not full.is_rectified:
        mask = np.ones(image.shape[:2], bool) if mask is None else mask  # unusable from outside
        across, down = _source_pixels(full)
        edge = cv2.BORDER_REPLICATE
        image = np.asarray(cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=edge))
    place = _place(log, stream, frame, scale, held_out)
    if scale != 1.0:
        size = (place.camera.width, place.camera.height)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return replace(place, image=image, mask=None if mask is None else fit_mask(full, mask, scale))


def _place(
    log: DrivingLog, stream: CameraStream, frame: int, scale: float, held_out: bool
) -> TrainingView:
    timestamp_us = int(stream.timestamps_us[frame])
    return TrainingView(
        camera_name=stream.name,
        frame=frame,
        timestamp_us=timestamp_us,
        camera=scaled_camera(stream.camera, scale),
        world_from_camera=log.world_from_rig.at(timestamp_us) @ stream.rig_from_camera,
        held_out=held_out,
    )


def scaled_camera(camera: PinholeCamera, scale: float) -> PinholeCamera:
    """The rectified camera of the image scaled by `scale`, its size rounded to whole pixels."""
    width, height = round(camera.width * scale), round(camera.height * scale)
    return camera.rectified().resized(max(1, width), max(1, height))


def nearest_views(
    views: Sequence[TrainingView], timestamp_us: int, limit_us: int
) -> Iterator[TrainingView]:
    """Of each camera the view nearest in time, where it is within `limit_us`."""
    for name in dict.fromkeys(view.camera_name for view in views):
        own = [view for view in views if view.camera_name == name]
        best = min(own, key=lambda view: abs(view.timestamp_us - timestamp_us))
        if abs(best.timestamp_us - timestamp_us) <= limit_us:
            yield best


def fit_mask(camera: PinholeCamera, mask: Mask, scale: float) -> Mask:
    """A mask (H, W) of the recorded image as it lies on its view: rectified and scaled."""
    fitted = mask.astype(np.uint8)
    if not camera.is_rectified:  # pixels from outside the recorded image: 0
        fitted = np.asarray(cv2.remap(fitted, *_source_pixels(camera), cv2.INTER_NEAREST), np.uint8)
    target = scaled_camera(camera, scale)
    size = (target.width, target.height)
    return cv2.resize(fitted, size, interpolation=cv2.INTER_NEAREST) > 0


@lru_cache(maxsize=1)  # a camera's images come one after the other
def _source_pixels(camera: PinholeCamera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where OpenCV finds the pixels (H, W) of the rectified image in the recorded one: x and y."""
    target = camera.rectified()
    pixels, _ = camera.project(target.rays(target.pixel_grid()))
    found = pixels.astype(np.float32) - np.float32(0.5)  # it puts centres at whole numbers
    return found[..., 0], found[..., 1]
