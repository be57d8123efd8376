"""What surrounds a vehicle in the images that show it: layers behind and before it, and its shadow.

Only the vehicle changes while it is refined. A step draws the vehicle alone and puts it between
two layers, drawn once from the scene, which costs a fifth of drawing the whole street.

The scene knows the road without the vehicle, the images show it with the vehicle's shadow. Places
that got darker tell the direction of the sun better than all walls of a street.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from recast.actors.actor import Actor
from recast.actors.evidence import Evidence, Sighting
from recast.actors.icp import outer_surface, thinned
from recast.arrays import Array
from recast.geometry import boxes, se3
from recast.geometry.colour import GAMMA
from recast.scene import StreetScene
from recast.scene.actor import draw
from recast.scene.light import CastShadow, SceneLight
from recast.scene.light.sun import DIRECTIONS
from recast.scene.sky import composite, pixel_coordinates
from recast.splats import CLASSIC, Gaussians, concatenate, refiltered

_GAINS = (0.8, 1.25)
_GAIN_PRIOR = 40.0  # pixels' worth of evidence for a gain of one
_REACH_M = 3.0  # around the box
_PIXELS, _FEWEST = 600, 10  # of an image
_CLEAR = 0.9  # share of light that must pass what is nearer
_ON_IT = 0.02  # of the mask: such pixels may show the vehicle itself
_BLACK, _STRONGEST = 0.05, 1.2  # display value added before a logarithm, and the largest logarithm
_DARKNESS, _DARKNESS_PRIOR = (0.2, 1.3), 2.0


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
        camera_from_world, world_from_object: (4, 4) float32.
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

    def around(self, rgb: Tensor, alpha: Tensor) -> Tensor:
        """The picture (H, W, 3) of a vehicle drawn alone as rgb (H, W, 3) and alpha (H, W)."""
        back = self.street * (1 - self.shade)[..., None]
        inner = rgb + (1 - alpha)[..., None] * back
        return self.front + self.through[..., None] * inner


def make_layers(scene: StreetScene, evidence: Evidence, shadow: Gaussians) -> list[Layers]:
    """The layers of every sighting, from a scene that may hold a model of the track or not.

    Args:
        shadow: shadow of the vehicle, actor frame; it lies behind the vehicle.
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
        front, back = (draw(street.select(chosen), view, camera) for chosen in (nearer, ~nearer))
        shade = draw(cast, view, camera).alpha
        behind = composite(
            back.rgb,
            back.alpha,
            scene.sky.colours,
            pixel_coordinates(camera, sighting.camera_from_world),
        ).clamp(0, 1)
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


@dataclass(frozen=True)
class RoadPixels:
    """Pixels of one image that show road beside a vehicle.

    Attributes:
        places: (P, 2) metres, where they lie on the ground of the actor frame.
        image: (P,) display values, mean of the channels, the gain of the exposure undone.
        street: (P,) the same of the scene without the vehicle.
        pose: (4, 4) `world_from_actor`.
        weight: what the image counts beside the others, see `recast.actors.evidence.Sighting`.
    """

    places: Array
    image: Array
    street: Array
    pose: Array
    weight: float


@dataclass(frozen=True)
class ShadowEvidence:
    """What the images of a vehicle say of its shadow.

    Attributes:
        sun: (D,) logarithms of how likely the sun stands in each of `recast.scene.light.sun`'s
            directions, world frame, up to a constant; zeros where nothing is told.
        darkness: factor of the contact shadow's opacity; one where nothing is told.
    """

    sun: Array
    darkness: float


def shadow_evidence(actor: Actor, scene: StreetScene, views: Sequence[Layers]) -> ShadowEvidence:
    """Compare the road about a registered actor with its shadow.

    Every image counts as one measurement: -n/2 log(1 - r^2) for the correlation r between the
    logarithms of the expected and the found loss of light, r > 0.
    """
    if len(actor.shadow) == 0:
        return ShadowEvidence(np.zeros(DIRECTIONS), 1.0)
    floor = float(actor.shadow.means[:, 2].median())
    roads = [one for view in views if (one := road_pixels(view, actor.size, floor)) is not None]
    light = SceneLight.of(scene)
    shadow = CastShadow(outer_surface(actor.gaussians).points, actor.shadow, actor.size)
    expected = [
        shadow.left(light.place(road.pose, actor.size), float(se3.yaw(road.pose)), road.places)
        for road in roads
    ]
    sun = _sun(roads, [left for left, _ in expected])
    probability = light.sun.given(sun).probability
    found, square = _DARKNESS_PRIOR, _DARKNESS_PRIOR
    for road, (left, without_contact) in zip(roads, expected, strict=True):
        # Linear light: image over street = without contact - darkness x (without contact - left).
        ratio = np.clip(road.image / np.maximum(road.street, _BLACK), 0, 1) ** GAMMA
        missing = probability @ without_contact - ratio
        hidden = probability @ (without_contact - left)
        found += road.weight * float(missing @ hidden)
        square += road.weight * float(hidden @ hidden)
    return ShadowEvidence(sun, min(max(found / square, _DARKNESS[0]), _DARKNESS[1]))


def road_pixels(view: Layers, size: Array, floor: float) -> RoadPixels | None:
    """The road pixels of one image; None if there are only a few.

    Args:
        size: (3,) size of the vehicle's box, metres.
        floor: height of the ground in the actor frame.
    """
    sighting = view.sighting
    around = cv2.dilate((sighting.mask > _ON_IT).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    beside = ~around & (sighting.trust > 0) & (view.through.numpy() > _CLEAR)
    object_from_camera = se3.inverse(sighting.camera_from_object)
    rays = sighting.camera.rays(sighting.camera.pixel_grid()[beside])
    rays = rays @ object_from_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        distance = (floor - object_from_camera[2, 3]) / rays[:, 2]
    down = (rays[:, 2] < 0) & (distance > 0)
    places = object_from_camera[:2, 3] + np.where(down, distance, 0)[:, None] * rays[:, :2]
    near = np.flatnonzero(down & (np.abs(places) < size[:2] / 2 + _REACH_M).all(axis=1))
    if len(near) < _FEWEST:
        return None
    near = thinned(near, _PIXELS)
    image, street = (
        layer.numpy()[beside][near].astype(np.float64).mean(axis=1)
        for layer in (view.target, view.street)
    )
    return RoadPixels(places[near], image, street, sighting.world_from_object, sighting.weight)


def _sun(roads: Sequence[RoadPixels], expected: Sequence[Array]) -> Array:
    """(D,) see `ShadowEvidence`; `expected` is the share of light left, (D, P) for each image."""
    cross, square, total = np.zeros(DIRECTIONS), np.full(DIRECTIONS, 1e-12), 1e-12
    for road, left in zip(roads, expected, strict=True):
        wanted = np.log((road.image + _BLACK) / (road.street + _BLACK))
        wanted = np.clip(wanted, -_STRONGEST, _STRONGEST)
        shade = np.log(np.maximum(left, _BLACK)) / GAMMA
        wanted, shade = wanted - wanted.mean(), shade - shade.mean(axis=1, keepdims=True)
        share = road.weight / len(wanted)
        cross = cross + share * (shade @ wanted)
        square = square + share * (shade * shade).sum(axis=1)
        total += share * float(wanted @ wanted)
    r = np.maximum(cross / np.sqrt(square * total), 0.0)
    return -0.5 * len(roads) * np.log(np.maximum(1 - r * r, 1e-6))
