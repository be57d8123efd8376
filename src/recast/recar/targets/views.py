"""The four views of a vehicle that its target is made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.errors import InputError
from recast.recar.camera import ELEVATION_DEG, FOV_DEG
from recast.recar.picture import Image, decode_picture
from recast.recar.record import SetRecord
from recast.recar.source import IdentitySource
from recast.recar.targets.record import VIEWS_DEG

FARTHEST_DEG = 22.5
"""A picture farther than this from front, rear, left or right does not stand for it."""

_DISTANCE = 2.0  # of the published camera helper, in units of the vehicle's longest side


def nearest_views(record: SetRecord) -> tuple[int, ...]:
    """Views nearest to front, rear, left and right, in this order; the first of equally near ones.

    Raises:
        InputError: the set has no view within 22.5 degrees of one of them.
    """
    azimuths = np.array(record.azimuths_deg)
    chosen = []
    for wanted in VIEWS_DEG:
        error = np.abs((azimuths - wanted + 180.0) % 360.0 - 180.0)
        index = int(np.argmin(np.round(error, 6)))
        if error[index] > FARTHEST_DEG:
            raise InputError(
                record.name, "azimuths", f"no view within {FARTHEST_DEG:g} degrees of {wanted:g}",
                "targets need a view of front, rear, left and right",
            )  # fmt: skip
        chosen.append(index)
    return tuple(chosen)


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture was taken from, in units of the vehicle's longest side.

    Attributes:
        azimuth_deg, elevation_deg: of the camera; 0 degrees ahead, 90 to the left.
        fov_deg: angle of view across the picture.
        distance: from the middle of the vehicle.
    """

    azimuth_deg: float
    elevation_deg: float = ELEVATION_DEG
    fov_deg: float = FOV_DEG
    distance: float = _DISTANCE


@dataclass(frozen=True)
class EncodedView:
    """A picture that has not been decoded.

    Attributes:
        name: for messages.
        png: its bytes.
        width, height: that it must have.
        viewpoint: of its camera, as far as the set says.
    """

    name: str
    png: bytes
    width: int
    height: int
    viewpoint: Viewpoint

    def picture(self) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha.

        Raises:
            InputError: the picture is broken.
        """
        return decode_picture(self.png, self.name, self.width, self.height)


def encoded_view(identity: IdentitySource, index: int) -> EncodedView:
    """A view of a vehicle with its viewpoint; what the set did not measure is as by default.

    Raises:
        InputError: the file is missing.
    """
    shared, own = identity.set_record, identity.record
    elevation = ELEVATION_DEG if shared.elevation_deg is None else shared.elevation_deg
    viewpoint = Viewpoint(shared.azimuths_deg[index], elevation)
    if shared.fov_deg is not None and own.distance_m is not None and own.size is not None:
        distance = own.distance_m / max(own.size)
        viewpoint = Viewpoint(shared.azimuths_deg[index], elevation, shared.fov_deg, distance)
    return EncodedView(
        f"view {index}", identity.encoded(index), shared.width, shared.height, viewpoint
    )
