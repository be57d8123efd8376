"""What all people of the synthetic streets have: limbs, sizes, clothes, phases of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se3
from recast.synthetic.scenery.primitives import at, lathe, pose
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.world import VehicleModel

Colour = tuple[float, float, float]

_FORWARD = np.array([1.0, 0.0, 0.0])
_SIDES = 10
_PHASES = 64
_BOX_MARGIN = 0.004
"""Metres around the phases that were looked at: what moves between them."""


def limb(length: float, upper: float, lower: float, colour: Colour, flat: float = 1.0) -> Surface:
    """A limb with round ends from the origin down to z = -length.

    Args:
        length: distance of its two joints, metres.
        upper, lower: radii at the joints, metres; the round ends reach beyond them.
        colour: linear RGB.
        flat: factor of the extent along x.
    """
    turn = np.linspace(-np.pi / 2, np.pi / 2, 7)
    low = np.stack([lower * np.cos(turn[:4]), -length + lower * np.sin(turn[:4])], axis=1)
    high = np.stack([upper * np.cos(turn[3:]), upper * np.sin(turn[3:])], axis=1)
    profile = np.concatenate([low, high])
    profile[[0, -1], 0] = 0.0
    return lathe(profile, _SIDES, colour, "fabric").scaled((flat, 1.0, 1.0))


def ball(radii: Sequence[float], colour: Colour, material: str = "matte") -> Surface:
    """An ellipsoid about the origin with these half axes along x, y and z, metres."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 8)
    profile = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    profile[[0, -1], 0] = 0.0
    return lathe(profile, 12, colour, material).scaled(radii)


def between(start: ArrayLike, end: ArrayLike, forward: Array = _FORWARD) -> Array:
    """Pose (4, 4) of a limb from one joint to another: its -z axis points from start to end.

    Args:
        start, end: (3,) metres, at different places.
        forward: (3,) where its x axis points as far as possible; not parallel to the limb.
    """
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    up = (start - end) / np.linalg.norm(start - end)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    return se3.from_rotation_translation(np.stack([np.cross(left, up), left, up], axis=1), start)


def turned(angle: float, place: ArrayLike) -> Array:
    """Pose (4, 4) at `place` (3,), turned by `angle` radians about y: z towards x."""
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    return se3.from_rotation_translation(rotation, np.asarray(place, np.float64))


def middle_joint(
    root: ArrayLike, end: ArrayLike, upper: float, lower: float, towards: ArrayLike
) -> Array:
    """Place (3,) of a knee or elbow: `upper` metres from the root, `lower` from the end.

    The two limbs form a triangle with the line from root to end (law of cosines). If the end is out
    of reach, the limbs are stretched out straight and the lower one is too short for its end.

    Args:
        root, end: (3,) metres.
        towards: (3,) direction in which the joint bends.
    """
    root, end = np.asarray(root, np.float64), np.asarray(end, np.float64)
    reach = float(np.linalg.norm(end - root))
    axis = (end - root) / reach
    bend = np.asarray(towards, np.float64)
    bend = bend - (bend @ axis) * axis
    bend /= np.linalg.norm(bend)
    along = (upper**2 - lower**2 + reach**2) / (2 * reach)
    along = float(np.clip(along, -upper, upper))
    return root + along * axis + np.sqrt(upper**2 - along**2) * bend


def assembled(parts: Sequence[Surface], poses: Sequence[Array], shift: Array) -> Surface:
    """Parts at poses (4, 4), all moved by `shift` (3,)."""
    offset = pose(*shift)
    return concatenate(
        [part.transformed(offset @ place) for part, place in zip(parts, poses, strict=True)]
    )


@dataclass(frozen=True)
class PersonLook:
    """A person's size and clothes.

    Attributes:
        height: metres, standing.
        girth: factor of the limbs' thickness.
        skin, hair, top, trousers, shoes: linear RGB.
    """

    height: float
    girth: float
    skin: Colour
    hair: Colour
    top: Colour
    trousers: Colour
    shoes: Colour


class LimbMotion(Protocol):
    """Parts of a body, and where they are after some metres of way."""

    @property
    def parts(self) -> Sequence[Surface]:
        """Shapes, each in its own frame."""

    @property
    def cycle(self) -> float:
        """Metres after which the poses repeat, as far as the outline is concerned."""

    def poses(self, travelled: float) -> Sequence[Array]:
        """`body_from_part` (4, 4) of each part; the body stands on z = 0 above the origin."""


@dataclass(frozen=True)
class Gait:
    """A body that moves with the way it has gone; see `recast.synthetic.world.Articulation`.

    Attributes:
        motion: parts and poses.
        middle: (3,) box centre in the body's frame.
    """

    motion: LimbMotion
    middle: Array

    def surface_at(self, travelled: float) -> Surface:
        """Triangles in the actor-local frame; in number and order the same at any time."""
        return assembled(self.motion.parts, self.motion.poses(travelled), -self.middle)


def moving_model(kind: str, colour: str, motion: LimbMotion) -> VehicleModel:
    """A model whose box holds the body at every phase and stands on the ground."""
    zero = np.zeros(3)
    bounds = [
        assembled(motion.parts, motion.poses(motion.cycle * k / _PHASES), zero).bounds()
        for k in range(_PHASES)
    ]
    low = np.min([pair[0] for pair in bounds], axis=0) - _BOX_MARGIN
    high = np.max([pair[1] for pair in bounds], axis=0) + _BOX_MARGIN
    low[2] = 0.0
    gait = Gait(motion, (low + high) / 2)
    return VehicleModel(kind, kind, colour, high - low, gait.surface_at(0.0), gait)


def leg(look: PersonLook, thigh: float, shin: float) -> tuple[Surface, Surface, Surface]:
    """A thigh and a shin in trousers, of these lengths, and a shoe."""
    upper = limb(thigh, 0.082 * look.girth, 0.058 * look.girth, look.trousers)
    lower = limb(shin, 0.058 * look.girth, 0.042 * look.girth, look.trousers)
    return upper, lower, foot(look)


def arm(look: PersonLook, upper: float, fore: float) -> tuple[Surface, Surface, Surface]:
    """An upper arm and a forearm in sleeves, of these lengths, and a hand."""
    shoulder = limb(upper, 0.056 * look.girth, 0.044 * look.girth, look.top)
    elbow = limb(fore, 0.044 * look.girth, 0.036 * look.girth, look.top)
    return shoulder, elbow, at(ball((0.04, 0.028, 0.075), look.skin), 0.0, 0.0, -0.05)


def foot(look: PersonLook) -> Surface:
    """A shoe below and ahead of the ankle at the origin, its sole `ankle_height` lower."""
    size = look.height / 1.75
    shoe = ball((0.135 * size, 0.048 * size, 0.045 * size), look.shoes, "plastic")
    return at(shoe, 0.055 * size, 0.0, 0.045 * size - ankle_height(look))


def ankle_height(look: PersonLook) -> float:
    """Metres from the sole to the ankle."""
    return 0.082 * look.height / 1.75


def trunk(look: PersonLook, length: float) -> Surface:
    """Chest and belly from the shoulders' height at the origin down to the hips."""
    return limb(length, 0.165, 0.135, look.top, flat=0.62).scaled((look.girth, look.girth, 1.0))


def head(look: PersonLook) -> Surface:
    """A head about the origin, with a neck below."""
    size = look.height / 1.75
    skull = ball((0.098 * size, 0.078 * size, 0.118 * size), look.skin)
    neck = limb(0.16 * size, 0.05 * size, 0.055 * size, look.skin)
    return concatenate([skull, neck])


def hair(look: PersonLook) -> Surface:
    """A cap of hair about a head's middle."""
    size = look.height / 1.75
    cap = ball((0.1 * size, 0.086 * size, 0.11 * size), look.hair, "fabric")
    return at(cap, -0.018 * size, 0.0, 0.028 * size)
