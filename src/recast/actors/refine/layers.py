"""What lies behind and before a vehicle in the images that show it, drawn once from the scene.

Only the vehicle changes while it is refined. A step draws the vehicle alone and puts it between
these two layers, which costs a fifth of drawing the whole street.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.actors.evidence import Evidence, Sighting
from recast.geometry import boxes
from recast.scene import StreetScene
from recast.scene.sky import composite, pixel_coordinates
from recast.splats import CLASSIC, Gaussians, concatenate, rasterize, refiltered

_GAINS = (0.8, 1.25)
_GAIN_PRIOR = 40.0  # pixels' worth of evidence for a gain of one


@dataclass(frozen=True)
class Layers:
    """One sighting, ready to be compared with the vehicle between its layers.

    Attributes:
        sighting: the image, its mask and cameras.
        target: (H, W, 3) float32, the image with the gain of its exposure undone.
        street: (H, W, 3) float32, everything behind the vehicle but its shadow, sky included.
        shade: (H, W) float32, opacity of the vehicle's shadow on it.
        front: (H, W, 3) float32, what is nearer, weighted by its own opacity.
        through: (H, W) float32, share of light that passes what is nearer.
        mask, trust: (H, W) float32, see `Sighting`.
        compared: (H, W) float32 in [0, 1], where colours are compared: on the vehicle and its edge.
        camera_from_world, world_from_object, K: float32 matrices.
    """

    sighting: Sighting
    target: Tensor
    street: Tensor
    shade: Tensor
    front: Tensor
    through: Tensor
    mask: Tensor
    trust: Tensor
    compared: Tensor
    camera_from_world: Tensor
    world_from_object: Tensor
    K: Tensor

    def around(self, rgb: Tensor, alpha: Tensor) -> Tensor:
        """The picture (H, W, 3) of a vehicle drawn alone as rgb (H, W, 3) and alpha (H, W)."""
        back = self.street * (1 - self.shade)[..., None]
        inner = rgb + (1 - alpha)[..., None] * back
        return self.front + self.through[..., None] * inner


def make_layers(scene: StreetScene, evidence: Evidence, shadow: Gaussians) -> list[Layers]:
    """The layers of every sighting, from a scene that may hold a model of the track or not.

    Args:
        shadow: of the vehicle, actor frame; it lies behind the vehicle.
    """
    return [_layers(scene, evidence, sighting, shadow) for sighting in evidence.sightings]


def _layers(
    scene: StreetScene, evidence: Evidence, sighting: Sighting, shadow: Gaussians
) -> Layers:
    camera = sighting.camera
    view = torch.from_numpy(sighting.camera_from_world).float()
    K = torch.from_numpy(camera.matrix).float()
    poses = scene.actor_poses(sighting.timestamp_us)
    parts = [scene.background]
    for track_id, pose in poses.items():
        if track_id != evidence.track_id:
            time = sighting.timestamp_us
            actor = scene.actors[track_id].coloured_at(time).shaped_at(time)
            posed = actor.gaussians.transformed(torch.from_numpy(pose))
            parts.append(refiltered(posed, actor.low_pass, CLASSIC, view, K))
    cast = shadow.transformed(torch.from_numpy(sighting.world_from_object))
    street = concatenate(parts).detach()
    nearer = _nearer(street, evidence, sighting)
    with torch.no_grad():
        front, back = (
            rasterize(
                street.select(chosen), view, K, camera.width, camera.height,
                eps2d=CLASSIC.variance, antialiased=CLASSIC.antialiased,
            )
            for chosen in (nearer, ~nearer)
        )  # fmt: skip
        shade = rasterize(cast, view, K, camera.width, camera.height).alpha
        behind = composite(
            back.rgb, back.alpha, scene.sky.colours,
            pixel_coordinates(camera, sighting.camera_from_world),
        ).clamp(0, 1)  # fmt: skip
    image = torch.from_numpy(sighting.image).float() / 255
    mask, trust = torch.from_numpy(sighting.mask), torch.from_numpy(sighting.trust)
    through = 1 - front.alpha
    shaded = behind * (1 - shade)[..., None]
    gain = _gain(image, front.rgb + through[..., None] * shaded, mask, trust)
    reach = cv2.dilate((sighting.mask > 0.05).astype(np.uint8), np.ones((3, 3), np.uint8))
    return Layers(
        sighting=sighting,
        target=(image / gain).clamp(0, 1),
        street=behind,
        shade=shade,
        front=front.rgb,
        through=through,
        mask=mask,
        trust=trust,
        compared=torch.from_numpy(reach).float() * (trust > 0) * (through > 0.5),
        camera_from_world=view,
        world_from_object=torch.from_numpy(sighting.world_from_object).float(),
        K=K,
    )


def _nearer(street: Gaussians, evidence: Evidence, sighting: Sighting) -> Tensor:
    """(N,) bool: Gaussians before the nearest corner of the box; the road under it is not."""
    corners = boxes.corners(evidence.size, sighting.camera_from_object)
    pose = torch.from_numpy(sighting.camera_from_world).float()
    depth = street.means @ pose[2, :3] + pose[2, 3]
    return depth < float(corners[:, 2].min())


def _gain(image: Tensor, street: Tensor, mask: Tensor, trust: Tensor) -> Tensor:
    """(3,) factors of the image's colours over the scene's beside the vehicle, near one."""
    element = np.ones((7, 7), np.uint8)
    near = torch.from_numpy(cv2.dilate((mask.numpy() > 0.05).astype(np.uint8), element) > 0)
    beside = ~near & (trust > 0)
    shown, wanted = street[beside], image[beside]
    prior = _GAIN_PRIOR * 0.25
    gain = ((shown * wanted).sum(0) + prior) / ((shown * shown).sum(0) + prior)
    return gain.clamp(*_GAINS)
