"""What the road around a vehicle says of its shadow: where the sun stands, and how dark it is.

The scene knows the road without the vehicle, the images show it with the vehicle's shadow. Places
that got darker tell the direction of the sun better than all walls of a street.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.actor import Actor
from recast.actors.hull import outer_surface
from recast.actors.refine.layers import Layers
from recast.geometry import se3
from recast.scene import StreetScene
from recast.scene.light import CastShadow, SceneLight
from recast.scene.light.sun import DIRECTIONS
from recast.scene.light.surfaces import GAMMA

Array = NDArray[np.float64]

_REACH_M = 3.0  # around the box
_PIXELS, _FEWEST = 600, 10  # of an image
_CLEAR = 0.9  # share of light that must pass what is nearer
_ON_IT = 0.02  # of the mask: such pixels may show the vehicle itself
_BLACK, _STRONGEST = 0.05, 1.2  # display value added before a logarithm, and the largest logarithm
_DARKNESS, _DARKNESS_PRIOR = (0.2, 1.3), 2.0


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
        size: (3,) of the vehicle's box, metres.
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
    near = near[:: -(-len(near) // _PIXELS)]
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
