"""One image that another program asks for, whatever its protocol, and the refusal of a request."""

from __future__ import annotations

from dataclasses import dataclass

from recast.arrays import Array
from recast.cameras import PinholeCamera, RadialLens, RationalLens

AnyCamera = PinholeCamera | RationalLens | RadialLens

MOST_PIXELS = 3840 * 2160
"""Pixels of one image, at most."""
MOST_IN_ALL = 4 * MOST_PIXELS
"""Pixels of the images of one call, at most."""
MOST_SIDE = 65_500
"""Width and height of one image at most, which is what JPEG files can have (libjpeg)."""


class RefusedError(Exception):
    """A call that is answered with a status.

    Args:
        code: name of a gRPC status code, such as "NOT_FOUND".
    """

    def __init__(self, code: str, details: str) -> None:
        self.code, self.details = code, details
        super().__init__(f"{code}: {details}")


@dataclass(frozen=True)
class RenderRequest:
    """One image that is asked for."""

    scene_id: str
    camera: AnyCamera  # camera at the size of the image
    local_from_camera: Array  # (4, 4) camera pose at mid-frame
    timestamp_us: int  # log time at mid-frame
    poses: dict[str, Array]  # `local_from_actor` (4, 4) at mid-frame, of the named tracks
    # (4, 4) ego pose at mid-frame if the request says it; not needed to draw.
    local_from_rig: Array | None = None
