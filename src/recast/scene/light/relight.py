"""The light that a vehicle was recorded in, exchanged for that of where it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.geometry import se3
from recast.scene.light.cast_shadow import CastShadow
from recast.scene.light.place import LitSurface, SceneLight
from recast.scene.light.surfaces import GAMMA
from recast.scene.street_scene import SceneActor
from recast.splats import Gaussians
from recast.splats.sh import C0

Array = NDArray[np.float64]

COAT = 0.04
"""Reflectance of clear coat and glass at normal incidence."""
_MOST_MIRRORED = 0.5  # of a colour; the rest is paint, even on black
_DARKENING, _BRIGHTENING = 0.9, 0.3
"""Powers of the ratio of light, new over old. What gets brighter is trusted less: cameras flatten
what is bright, and generators know usual light: their shaded colours are not as dark as shade."""
_RATIO = (0.1, 6.0)
_DARKEST = 0.02  # display value
_PLACE_M, _TURN = 0.1, 0.005  # grid of metres, and of a quaternion's components


class ActorLight:
    """What is needed to light a vehicle anew: a `recast.scene.street_scene.Lighting`.

    Args:
        scene: light of the street.
        gaussians: the vehicle, actor frame, in the light that it was recorded in.
        surface: normals and places of the Gaussians.
        recorded: (N,) float32 light that each Gaussian's colour was recorded in.
        shadow: what makes the shadow; None if the vehicle has none.
    """

    def __init__(
        self,
        scene: SceneLight,
        gaussians: Gaussians,
        surface: LitSurface,
        recorded: Tensor,
        shadow: CastShadow | None,
    ) -> None:
        self.scene, self.surface, self.recorded, self.shadow = scene, surface, recorded, shadow
        self._paint = Paint(gaussians, COAT * scene.sky_radiance)

    @property
    def shadow_room(self) -> int:
        """Most Gaussians that the shadow has."""
        return 0 if self.shadow is None else self.shadow.room

    def lit(self, actor: SceneActor, pose: Array) -> SceneActor:
        """The actor in the light of where it stands, and not to be lit again.

        Args:
            pose: (4, 4) `world_from_actor`.
        """
        pose = rounded(pose)
        place = self.scene.place(pose, actor.size)
        light = self.scene.on(place, self.surface, pose[:3, :3])
        gaussians = self._paint.under(light / self.recorded)
        shadow = actor.shadow
        if self.shadow is not None:
            yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
            shadow = self.shadow.sheet(self.scene, place, yaw)
        return replace(actor, gaussians=gaussians, shadow=shadow, light=None)


def rounded(pose: Array) -> Array:
    """A pose (4, 4) on a grid of 10 cm and half a degree: light is worked out once for each."""
    quat = np.round(se3.matrix_to_quat(pose[:3, :3]) / _TURN) * _TURN
    place = np.round(pose[:3, 3] / _PLACE_M) * _PLACE_M
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), place)


def recorded_light(
    scene: SceneLight,
    surface: LitSurface,
    size: Array,
    poses: Sequence[Array],
    weights: Sequence[float] | None = None,
) -> Tensor:
    """Mean light (N,) that fell on a vehicle's surface over the places where it was seen.

    Args:
        size: (3,) of its box, metres.
        poses: (4, 4) `world_from_actor` each, at least one.
        weights: of the poses; the same for all if not given.
    """
    shares = np.ones(len(poses)) if weights is None else np.asarray(weights, np.float64)
    total = torch.zeros(len(surface.normals))
    for pose, share in zip(map(rounded, poses), shares / shares.sum(), strict=True):
        total += float(share) * scene.on(scene.place(pose, size), surface, pose[:3, :3])
    return total


class Paint:
    """A vehicle's colours, taken apart: what coat and glass mirror of the sky, the rest is paint.

    Args:
        gaussians: in the light that they were recorded in.
        mirrored: linear radiance up to which a colour may be mirrored.
    """

    def __init__(self, gaussians: Gaussians, mirrored: float) -> None:
        self._gaussians = gaussians
        linear = ((0.5 + C0 * gaussians.sh[:, 0]).clamp(_DARKEST, 1) ** GAMMA).mean(dim=1)
        self._coat = (mirrored / linear).clamp(max=_MOST_MIRRORED)

    def under(self, ratio: Tensor) -> Gaussians:
        """The Gaussians whose paint gets `ratio` (N,) times the light; what they mirror stays.

        Colours keep their hue. A ratio of exactly one changes nothing.
        """
        ratio = ratio.clamp(*_RATIO)
        gain = torch.where(ratio < 1, ratio**_DARKENING, ratio**_BRIGHTENING)
        factor = torch.lerp(gain, torch.ones_like(gain), self._coat) ** (1 / GAMMA)
        sh = self._gaussians.sh * factor[:, None, None]
        sh[:, 0] += (0.5 / C0) * (factor - 1)[:, None]
        return replace(self._gaussians, sh=sh)
