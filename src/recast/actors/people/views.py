"""Images of a person with what is known of them, and a body drawn into them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.actors.observation import Observation
from recast.actors.people.body import BodySurface
from recast.actors.template.cloud import flat_gaussians
from recast.arrays import Array, Float32Array
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.scene.actor import draw
from recast.scene.deformation import Gait
from recast.splats import MIP, Gaussians
from recast.splats.gaussians import C0

if TYPE_CHECKING:
    from recast.actors.refine.images import Layers

_OPACITY, _OVERLAP = 0.99, 1.4  # patches overlap so far that the back does not shine through
_APART = 0.15  # display values: less may be the street
NOWHERE = np.array([[0.0, 0.0], [1.0, 0.0]])
"""The way of a body that is not placed on one yet."""


@dataclass(frozen=True)
class PersonView:
    """One image of a person, between what is behind it and what hides it."""

    camera: PinholeCamera  # pinhole of the crop, without distortion
    camera_from_object: Array  # (4, 4)
    image: Tensor  # (H, W, 3) float32 display values
    back: Tensor  # (H, W, 3) the street behind, with the person's shadow
    front: Tensor  # (H, W, 3) what is nearer, weighted by its own opacity
    through: Tensor  # (H, W) share of light that passes what is nearer
    mask: Float32Array  # (H, W) in [0, 1], 1 on the person
    trust: Float32Array  # (H, W) in [0, 1]
    apart: Float32Array  # (H, W) in [0, 1], 0 where the image is as the street alone
    weight: float  # beside the other images
    gone: float  # metres of the person's way, see `Polyline.gone`

    @classmethod
    def of_crop(cls, observation: Observation) -> PersonView:
        """The crop of an observation, at an unknown place of the way.

        What a body does not cover is as in the image: no street is known.
        """
        rgba = torch.from_numpy(observation.rgba.copy()).float() / 255
        image, mask = rgba[..., :3].contiguous(), rgba[..., 3].numpy()
        return cls(
            camera=observation.camera,
            camera_from_object=np.array(observation.camera_from_object),
            image=image,
            back=image,
            front=torch.zeros_like(image),
            through=torch.ones(image.shape[:2]),
            mask=mask,
            trust=np.ones_like(mask),
            apart=np.ones_like(mask),
            weight=1.0,
            gone=0.0,
        )

    @classmethod
    def of_layers(cls, layers: Layers, gait: Gait) -> PersonView:
        """One image of the evidence of somebody with a gait."""
        sighting = layers.sighting
        usable = (layers.through > 0.5).numpy()
        back = layers.street * (1 - layers.shade)[..., None]
        alone = layers.front + layers.through[..., None] * back
        apart = ((alone - layers.target).abs().amax(dim=-1) / _APART).clamp(0, 1)
        return cls(
            camera=sighting.camera,
            camera_from_object=sighting.camera_from_object,
            image=layers.target,
            back=back,
            front=layers.front,
            through=layers.through,
            mask=sighting.mask,
            trust=sighting.trust * usable,
            apart=apart.numpy(),
            weight=sighting.weight,
            gone=gait.gone_at(sighting.world_from_object),
        )

    def shrunk(self, most: int) -> PersonView:
        """The view with at most so many pixels on its longer side."""
        height, width = self.mask.shape
        share = most / max(height, width)
        if share >= 1:
            return self
        size = max(1, round(share * width)), max(1, round(share * height))

        def small(values: Array | Float32Array) -> Float32Array:
            return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

        def tensor(values: Tensor) -> Tensor:
            return torch.from_numpy(small(values.numpy()))

        return replace(
            self,
            camera=self.camera.resized(*size),
            image=tensor(self.image),
            back=tensor(self.back),
            front=tensor(self.front),
            through=tensor(self.through),
            mask=small(self.mask),
            trust=small(self.trust),
            apart=small(self.apart),
        )

    @property
    def area(self) -> float:
        """Trusted pixels of the mask, at least one."""
        return max(float((self.mask * self.trust).sum()), 1.0)

    def drawn(self, gaussians: Gaussians) -> tuple[Tensor, Tensor]:
        """The picture (H, W, 3) with a body, and the body's opacity (H, W); differentiable."""
        shown = draw(gaussians, self.camera_from_object, self.camera, MIP)
        inner = shown.rgb + (1 - shown.alpha)[..., None] * self.back
        return self.front + self.through[..., None] * inner, shown.alpha

    def differs(self, picture: Tensor, alpha: Tensor) -> tuple[float, float]:
        """Shares of the mask's area by which outlines differ, and by which display values do."""
        outline = float((np.abs(alpha.numpy() - self.mask) * self.trust).sum())
        wrong = (picture - self.image).abs().mean(dim=-1).numpy() * self.trust
        return outline / self.area, float(wrong.sum()) / self.area


def box_from_body(size: Array, place: Array) -> Array:
    """(4, 4) of a body that stands on the box's floor."""
    return se3.from_rotation_translation(np.eye(3), [place[0], place[1], -float(size[2]) / 2])


def gaussians_of(surface: BodySurface, pose: Array, colours: Array | Tensor) -> Gaussians:
    """One Gaussian a patch, of display colours (N, 3), in the box frame.

    Args:
        pose: (4, 4) `box_from_body`.
    """
    points = se3.apply(pose, surface.points)
    sh = (np.asarray(colours, np.float64) - 0.5)[:, None] / C0
    rows = np.arange(len(points))
    edges = _OVERLAP * surface.spacing
    return flat_gaussians(rows, points, surface.normals, edges, sh, _OPACITY)


def gait_of(surface: BodySurface, pose: Array, cycle: float, phase: float, way: Array) -> Gait:
    """The gait of a body at `pose` (4, 4) `box_from_body`, on a way (K, 2)."""
    motions = pose @ surface.motions @ se3.inverse(pose)
    return Gait(
        torch.from_numpy(surface.weights).float(),
        se3.matrix_to_quat(motions[..., :3, :3]),
        np.ascontiguousarray(motions[..., :3, 3]),
        cycle,
        phase,
        way,
    )
