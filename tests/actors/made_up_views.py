"""Background-free crops of made-up vehicles."""

from __future__ import annotations

import numpy as np
import torch

from recast.actors import Observation
from recast.actors.observe import observation_of_view
from recast.cameras import PinholeCamera
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.scene.actor import draw, look_at
from recast.splats import Gaussians
from support import made_up_actors as made_up

CAMERA = PinholeCamera(320, 200, 360.0, 360.0, 160.0, 100.0)


def seen_from(
    vehicle: Gaussians, azimuth: float, shift: float = 0.0, level: float = 1.0
) -> Observation:
    """A background-free crop from 9 m away; degrees, 0 ahead and 90 to the left.

    Args:
        shift: metres by which the box is labelled too far to the left in the image.
        level: factor on the linear light.
    """
    turn = np.radians(azimuth)
    eye = np.array([9 * np.cos(turn), 9 * np.sin(turn), 1.0])
    camera_from_object = look_at(eye, np.zeros(3))
    with torch.no_grad():
        picture = draw(vehicle, camera_from_object, CAMERA)
    alpha = (picture.alpha.numpy() > 0.5).astype(np.uint8) * 255
    colour = linear_to_gamma(level * gamma_to_linear(np.clip(picture.rgb.numpy(), 0, 1)))
    rgba = np.dstack([(colour * 255).astype(np.uint8), alpha])
    labelled = camera_from_object.copy()
    labelled[0, 3] -= shift
    return observation_of_view(rgba, CAMERA, labelled, made_up.SIZE, name=f"{azimuth:.0f}")
