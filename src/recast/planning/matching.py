"""Which camera of a rig stands for which that a planner knows: by direction and field of view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.planning.types import CameraMount

Array = NDArray[np.float64]

WITHIN_DEGREES = 30.0
"""A camera that looks further off than this does not stand for a wanted one."""


@dataclass(frozen=True)
class Look:
    """Where a camera looks, whatever its name.

    Attributes:
        direction: (3,) unit vector through the image's centre, rig frame.
        field: horizontal field of view, degrees.
    """

    direction: Array
    field: float

    @classmethod
    def level(cls, yaw: float, field: float) -> Look:
        """A level look, `yaw` degrees to the left of ahead."""
        turn = np.deg2rad(yaw)
        return cls(np.array([np.cos(turn), np.sin(turn), 0.0]), field)

    @classmethod
    def of(cls, mount: CameraMount) -> Look:
        """The look of a camera."""
        camera = mount.camera
        across = np.array([0.0, 0.5, 1.0]) * camera.width
        rays = camera.rays(np.stack([across, np.full(3, camera.height / 2)], axis=-1))
        left, centre, right = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        direction: Array = mount.rig_from_camera[:3, :3] @ centre
        return cls(direction, float(degrees_between(left, right)))

    @property
    def yaw(self) -> float:
        """Degrees to the left of ahead."""
        return float(np.rad2deg(np.arctan2(self.direction[1], self.direction[0])))

    def __str__(self) -> str:
        yaw = round(self.yaw)
        side = "left" if yaw > 0 else "right"
        where = f"{abs(yaw)} degrees {side}" if yaw else "ahead"
        return f"{where}, {self.field:.0f} wide"

    def angle(self, other: Look) -> float:
        """Degrees between the two directions."""
        return float(degrees_between(self.direction, other.direction))

    def likeness(self, other: Look) -> float:
        """0 to 1: what both fields see over what either sees, as if side by side in one plane."""
        both = min((self.field + other.field) / 2 - self.angle(other), self.field, other.field)
        return max(both, 0.0) / (self.field + other.field - max(both, 0.0))


def match_cameras(wanted: Mapping[str, Look], mounts: Mapping[str, CameraMount]) -> dict[str, str]:
    """The camera that stands for each wanted one, each camera for one only.

    A camera may stand for one if it looks within `WITHIN_DEGREES` of its direction. Of those, the
    pairs whose fields of view agree best are made first; equal ones in the order of the arguments.

    Args:
        wanted: by the planner's names.
        mounts: by the rig's names, which do not matter.

    Returns:
        wanted name to the rig's, in the order of `wanted`; without those with no camera left.
    """
    looks = {name: Look.of(mount) for name, mount in mounts.items()}
    pairs = sorted(
        # Rounded: the same rig under other names, in other units, is still in the same order.
        (-round(want.likeness(look), 6), i, j, name, camera)
        for i, (name, want) in enumerate(wanted.items())
        for j, (camera, look) in enumerate(looks.items())
        if want.angle(look) <= WITHIN_DEGREES
    )
    found: dict[str, str] = {}
    for _, _, _, name, camera in pairs:
        if name not in found and camera not in found.values():
            found[name] = camera
    return {name: found[name] for name in wanted if name in found}


def directions(mounts: Mapping[str, CameraMount]) -> str:
    """The cameras for a message, such as "CAM_FRONT (ahead, 65 wide)"; "none" if there are none."""
    return ", ".join(f"{name} ({Look.of(mount)})" for name, mount in mounts.items()) or "none"


def degrees_between(a: Array, b: Array) -> Array:
    """Angles (...) between directions (..., 3)."""
    # The sine too: arccos alone knows nothing of angles below a millionth.
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    angles: Array = np.rad2deg(np.arctan2(sine, np.sum(a * b, axis=-1)))
    return angles
