"""The views that generated vehicles are compared in: those of the set, or the paper's orbit.

The paper (section 5, Q3) renders target views with an angle of view of 40 degrees, a pitch of 15
and azimuths of 0, 90, 180 and 270 degrees. That fits the camera of the published image-to-3D code
(512 x 512 pixels, radius 2 about a vehicle whose longest side is 1). How photographs were brought
to these views it does not say; here they are scaled about their centre, see `orbit_case`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.evaluation.actor_cases import ActorCase, ActorView
from recast.recar.camera import FOV_DEG, pinhole

Image = NDArray[np.uint8]

Targets = Literal["set", "orbit"]
"""`set`: the cameras of the photographs; `orbit`: the paper's."""

ORBIT_PIXELS = 512
ORBIT_RADIUS = 2.0
"""Distance of the orbit's camera from the box centre, in longest sides of the box."""
_ASIDE = 1e-3  # of the distance, by which a camera may look past the box centre


def target_case(case: ActorCase, targets: Targets) -> ActorCase:
    """The case with the views that are asked for.

    Raises:
        InputError: see `orbit_case`.
    """
    return orbit_case(case) if targets == "orbit" else case


def orbit_case(case: ActorCase) -> ActorCase:
    """The case with its targets seen from the orbit: 512 x 512 pixels, 40 degrees, radius 2.

    A view keeps the direction of its photograph. The photograph is scaled about its centre so that
    lengths at the box centre are those of the orbit's picture; its perspective stays that of its
    own distance. Beyond its edges there is nothing.

    Raises:
        InputError: a camera that does not look at the box centre.
    """
    radius = ORBIT_RADIUS * float(case.size.max())
    return replace(case, targets=tuple(_orbit_view(case.id, one, radius) for one in case.targets))


def _orbit_view(id: str, view: ActorView, radius: float) -> ActorView:
    right, down, distance = view.camera_from_actor[:3, 3]
    middle = abs(view.camera.cx - view.camera.width / 2) + abs(
        view.camera.cy - view.camera.height / 2
    )
    if max(abs(right), abs(down)) > _ASIDE * distance or middle > 1.0:
        raise InputError(
            f"{id}/{view.name}", "camera", "does not look at the box centre",
            "compare in the set's own views: --targets set",
        )  # fmt: skip
    camera = pinhole(ORBIT_PIXELS, ORBIT_PIXELS, FOV_DEG)
    pose = view.camera_from_actor.copy()
    pose[:3, 3] = (0.0, 0.0, radius)
    scale = (view.camera.fx / distance) / (camera.fx / radius)
    load = partial(_scaled, view.load, float(scale), (view.camera.cx, view.camera.cy))
    return replace(view, load=load, camera=camera, camera_from_actor=pose)


def _scaled(load: Callable[[], Image], scale: float, centre: tuple[float, float]) -> Image:
    """A picture about its centre, `scale` of its pixels a pixel of the orbit's: straight alpha.

    Colours are weighed by alpha. Several samples a pixel, so that none of the picture is missed.
    """
    rgba = load()
    alpha = rgba[..., 3:].astype(np.float32) / 255
    light = np.concatenate([rgba[..., :3] * (alpha / 255), alpha], axis=2)
    samples = max(1, math.ceil(scale))
    total = np.zeros((ORBIT_PIXELS, ORBIT_PIXELS, 4), np.float64)
    offsets = (np.arange(samples) + 0.5) / samples - ORBIT_PIXELS / 2
    for right in offsets:
        for down in offsets:
            # OpenCV counts pixel centres from 0, our cameras from one half
            shift = [centre[0] + scale * right - 0.5, centre[1] + scale * down - 0.5]
            matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
            total += cv2.warpAffine(
                light, matrix, (ORBIT_PIXELS, ORBIT_PIXELS),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT,
            )  # fmt: skip
    mean = total / samples**2
    colour = mean[..., :3] / np.maximum(mean[..., 3:], 1e-6)
    found = np.concatenate([colour, mean[..., 3:]], axis=2)
    return np.clip(np.round(255 * found), 0, 255).astype(np.uint8)


def elevation_deg(view: ActorView) -> float:
    """Degrees of a view's camera above the horizontal through the box centre."""
    eye = -view.camera_from_actor[:3, :3].T @ view.camera_from_actor[:3, 3]
    return float(np.degrees(np.arctan2(eye[2], np.hypot(eye[0], eye[1]))))
