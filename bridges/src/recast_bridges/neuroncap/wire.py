"""Images and cameras as NeuroNCAP's messages have them."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping

import torch

from recast.arrays import Image
from recast.cameras import CameraMount
from recast.cameras.mounts import Look, match_cameras
from recast.logs import images

CAMERAS: Mapping[str, Look] = {
    "CAM_FRONT": Look.level(0.0, 65.0),
    "CAM_FRONT_LEFT": Look.level(55.0, 65.0),
    "CAM_FRONT_RIGHT": Look.level(-55.0, 65.0),
    "CAM_BACK": Look.level(180.0, 90.0),
    "CAM_BACK_LEFT": Look.level(110.0, 65.0),
    "CAM_BACK_RIGHT": Look.level(-110.0, 65.0),
}
"""The six cameras of nuScenes in NeuroNCAP's order, and where they look, rounded."""
MEDIA_TYPES = {"raw": "text/plain", "png": "image/png", "jpg": "text/jpeg", "jpeg": "text/jpeg"}
"""Of the image formats, by their names; text/jpeg is what NeuroNCAP's own renderer says."""


def raw_image(image: Image) -> str:
    """An image (height, width, 3) uint8 RGB as base64 of what `torch.save` writes of it.

    The other side reads it with `torch.load`, which unpickles. Nothing here ever does.
    """
    stream = io.BytesIO()
    torch.save(torch.from_numpy(image.copy()), stream)
    return base64.b64encode(stream.getvalue()).decode("ascii")


def encode(image: Image, image_format: str) -> bytes:
    """An image (height, width, 3) uint8 RGB in a format of `MEDIA_TYPES`."""
    if image_format == "raw":
        return raw_image(image).encode("ascii")
    return images.encode(image, "png" if image_format == "png" else "jpeg")


def ncap_cameras(mounts: Mapping[str, CameraMount]) -> dict[str, str]:
    """NeuroNCAP's name to the rig's camera that stands for it: of the same name, or by direction.

    Cameras that no camera of the rig stands for are left out, and so are cameras with distortion,
    which the messages cannot say.
    """
    straight = {name: mount for name, mount in mounts.items() if mount.camera.is_rectified}
    found = {name: name for name in CAMERAS if name in straight}
    wanted = {name: look for name, look in CAMERAS.items() if name not in found}
    found |= match_cameras(wanted, {k: m for k, m in straight.items() if k not in found})
    return {name: found[name] for name in CAMERAS if name in found}
