"""Pictures of an actor from all around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.actor import Actor
from recast.arrays import Array
from recast.geometry import PinholeCamera, se3
from recast.splats import CLASSIC, Gaussians, LowPass, concatenate, rasterize
from recast.splats.gaussians import quat_to_matrix
from recast.splats.sh import C0

_DISTANCE = 2.1  # of the camera, in diagonals of the box
_SHADE = 0.55  # brightness of what lies flat against what stands upright


def turntable(
    actor: Actor,
    *,
    views: int = 8,
    width: int = 640,
    height: int = 360,
    elevation: float = float(np.radians(10.0)),
    background: tuple[float, float, float] = (0.55, 0.56, 0.58),
    with_shadow: bool = True,
) -> list[NDArray[np.uint8]]:
    """Render an actor from azimuths evenly around it; the first view faces its front.

    Args:
        actor: the vehicle.
        views: number of pictures, counter-clockwise seen from above.
        width, height: pixels.
        elevation: of the camera above the box centre, radians.
        background: display colour behind it.
        with_shadow: also draw the contact shadow.

    Returns:
        `views` images (height, width, 3) uint8.
    """
    parts = [actor.gaussians, actor.shadow] if with_shadow else [actor.gaussians]
    return orbit(
        concatenate(parts),
        actor.size,
        views=views,
        width=width,
        height=height,
        elevation=elevation,
        background=background,
        low_pass=actor.low_pass,
    )


def coloured_by_shares(actor: Actor, colours: Sequence[Sequence[float]]) -> Actor:
    """The actor in the colours of its shares, shaded by which way its surface faces.

    Args:
        actor: a refined one.
        colours: of what was seen, mirrored and invented, three times RGB in [0, 1].

    Raises:
        ValueError: the actor has no shares.
    """
    if actor.shares is None:
        raise ValueError("coloured_by_shares: the actor has no shares")
    gaussians = actor.gaussians.detach()
    thin = gaussians.log_scales.argmin(dim=1)
    up = quat_to_matrix(gaussians.quats)[torch.arange(len(gaussians)), 2, thin].abs()
    mixed = actor.shares.columns @ torch.tensor(colours, dtype=torch.float32)
    mixed = mixed * (1 - (1 - _SHADE) * (1 - up))[:, None]
    return replace(actor, gaussians=replace(gaussians, sh=((mixed - 0.5) / C0)[:, None]))


def orbit(
    gaussians: Gaussians,
    size: Array,
    *,
    views: int,
    width: int,
    height: int,
    elevation: float = float(np.radians(10.0)),
    background: tuple[float, float, float] = (0.55, 0.56, 0.58),
    low_pass: LowPass = CLASSIC,
) -> list[NDArray[np.uint8]]:
    """Render Gaussians about the origin from azimuths evenly around the z axis, the first from +x.

    Args:
        gaussians: z up, any unit.
        size: (3,) extents of what should fill the picture, same unit.
        views: number of pictures, counter-clockwise seen from above.
        width, height: pixels.
        elevation: of the camera, radians.
        background: display colour behind it.
        low_pass: the filter that they were made for.

    Returns:
        `views` images (height, width, 3) uint8.
    """
    gaussians = gaussians.detach()
    camera = framing_camera(size, width, height)
    distance = _DISTANCE * float(np.linalg.norm(size))
    images = []
    for azimuth in np.arange(views) * 2 * np.pi / views:
        direction = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        pose = look_at(distance * direction, np.zeros(3))
        with torch.no_grad():
            picture = rasterize(
                gaussians,
                torch.from_numpy(pose).float(),
                torch.from_numpy(camera.matrix).float(),
                width,
                height,
                background=torch.tensor(background),
                eps2d=low_pass.variance,
                antialiased=low_pass.antialiased,
            )
        images.append((picture.rgb.clamp(0, 1) * 255).round().to(torch.uint8).numpy())
    return images


def framing_camera(size: Array, width: int, height: int) -> PinholeCamera:
    """A camera that sees the whole box from `turntable`'s distance in every direction."""
    distance = _DISTANCE * float(np.linalg.norm(size))
    radius = 0.5 * float(np.linalg.norm(size[:2]))
    # the widest part is about as far as the middle, the lowest visible one half a radius nearer
    across = width / 2 / (1.08 * radius) * distance
    upright = height / (size[2] + 0.45 * radius) * (distance - 0.5 * radius)
    focal = 0.9 * min(across, upright)
    return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


def look_at(eye: Array, target: Array) -> Array:
    """`camera_from_object` (4, 4) of a level OpenCV camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return se3.from_rotation_translation(rotation, -rotation @ eye)
