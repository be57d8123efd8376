"""A request to render as what is drawn, checked before anything of its size is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from recast.arrays import Array, Image
from recast.logs import images
from recast.logs.checks import LATEST_US
from recast_bridges.alpasim.cameras import FTHETA_CENTRE, read_camera
from recast_bridges.alpasim.messages import MOST_BYTES
from recast_bridges.alpasim.poses import read_middle
from recast_bridges.requests import (
    MOST_IN_ALL,
    MOST_PIXELS,
    MOST_SIDE,
    RefusedError,
    RenderRequest,
)

PNG, JPEG, PLANAR = 1, 2, 4
"""Numbers of the image formats that recast encodes."""
JPEG_QUALITY = 95
"""Of requests that name none, which is what AlpaSim always asks for."""
_SHORTEST = 1e-3
"""Pixels of a focal length in the image asked for: less is a slip, and no number of float32."""


@dataclass(frozen=True, kw_only=True)
class SensorsimRequest(RenderRequest):
    """One image that is asked for, and how it is to be encoded.

    Attributes:
        image_format: `PNG`, `JPEG` or `PLANAR`.
        quality: JPEG quality, 1 to 100.
    """

    image_format: int
    quality: int


def read_requests(
    requests: Sequence[Any], ftheta_centre: float = FTHETA_CENTRE
) -> list[SensorsimRequest]:
    """The images that messages RGBRenderRequest of one call ask for.

    Raises:
        RefusedError: INVALID_ARGUMENT for a bad value, named by its field; RESOURCE_EXHAUSTED for
            more pixels than are drawn in one image or call.
    """
    pixels = [request.resolution_h * request.resolution_w for request in requests]
    if max(pixels, default=0) > MOST_PIXELS or sum(pixels) > MOST_IN_ALL:
        limits = f"the limit is {MOST_PIXELS} for an image and {MOST_IN_ALL} for a call"
        raise RefusedError("RESOURCE_EXHAUSTED", f"{sum(pixels)} pixels are requested; {limits}")
    try:
        return [_read(request, ftheta_centre) for request in requests]
    except ValueError as error:
        raise RefusedError("INVALID_ARGUMENT", str(error)) from None


def _read(request: Any, ftheta_centre: float) -> SensorsimRequest:
    height, width = request.resolution_h, request.resolution_w
    if not (0 < height <= MOST_SIDE and 0 < width <= MOST_SIDE):
        problem = f"{height} x {width}, expected 1 to {MOST_SIDE} pixels for each"
        raise ValueError(f"resolution_h, resolution_w: {problem}")
    if not request.HasField("camera_intrinsics"):
        raise ValueError("camera_intrinsics: is missing")
    if not request.HasField("sensor_pose"):
        raise ValueError("sensor_pose: is missing")
    start, end = request.frame_start_us, request.frame_end_us
    if end < start:
        raise ValueError(f"frame_end_us: {end} is before frame_start_us, {start}")
    if end >= LATEST_US:
        raise ValueError(f"frame_end_us: {end} is not a time in microseconds since 1970")
    if request.insert_ego_mask:
        raise ValueError("insert_ego_mask: recast has no ego masks")
    if request.image_format not in (PNG, JPEG, PLANAR):
        known = "1 (PNG), 2 (JPEG) or 4 (RGB_UINT8_PLANAR)"
        raise ValueError(f"image_format: is {request.image_format}, expected {known}")
    quality = request.image_quality
    if not 0.0 <= quality <= 100.0:
        raise ValueError(f"image_quality: {quality} is not between 0 and 100")
    poses: dict[str, Array] = {}
    for index, thing in enumerate(request.dynamic_objects):
        where = f"dynamic_objects[{index}]"
        if thing.track_id in poses:
            raise ValueError(f"{where}.track_id: {thing.track_id!r} is named twice")
        poses[thing.track_id] = read_middle(thing.pose_pair, f"{where}.pose_pair")
    rig = next((n for n in ("ego_pose", "challenge_ego_pose") if request.HasField(n)), None)
    camera = read_camera(request.camera_intrinsics, "camera_intrinsics", ftheta_centre)
    camera = camera.resized(width, height)
    camera.validate()
    if min(camera.fx, camera.fy) < _SHORTEST:
        raise ValueError(
            f"camera_intrinsics: focal lengths {camera.fx:g} and {camera.fy:g} pixels are not both "
            f"at least {_SHORTEST:g}"
        )
    return SensorsimRequest(
        scene_id=request.scene_id,
        camera=camera,
        local_from_camera=read_middle(request.sensor_pose, "sensor_pose"),
        timestamp_us=(start + end) // 2,
        poses=poses,
        image_format=request.image_format,
        quality=max(round(quality), 1) if quality else JPEG_QUALITY,
        local_from_rig=None if rig is None else read_middle(getattr(request, rig), "ego_pose"),
    )


def encode(image: Image, image_format: int, quality: int) -> bytes:
    """An image (height, width, 3) uint8 RGB as the bytes of a reply.

    Raises:
        RefusedError: RESOURCE_EXHAUSTED if they are longer than a message.
    """
    if image_format == PLANAR:
        data = np.moveaxis(image, -1, 0).tobytes()
    else:
        data = images.encode(image, "png" if image_format == PNG else "jpeg", quality)
    if len(data) > MOST_BYTES - 1024:
        raise RefusedError(
            "RESOURCE_EXHAUSTED", f"the image has {len(data)} bytes, too many for a reply"
        )
    return data
