"""What all people of the synthetic streets have: limbs, sizes, clothes, phases of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se3
from recast.synthetic.surface import Surface, at, boxes, concatenate, lathe, pose, tube
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
    """A person's size and clothes."""

    height: float  # metres, standing
    girth: float  # factor of the limbs' thickness
    # skin, hair, top, trousers, shoes: linear RGB.
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
class MovingSurface:
    """A body that moves with the way it has gone; see `recast.synthetic.world.Articulation`."""

    motion: LimbMotion  # parts and poses
    middle: Array  # (3,) box centre in the body's frame

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
    gait = MovingSurface(motion, (low + high) / 2)
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


STANCE = 0.58
"""Share of a cycle during which a foot is on the ground; 0.6 in people who walk at leisure."""
_STRIDE = 0.74
"""Metres of way in a cycle (two steps) to the body's height."""
_LIFT, _TIP = 0.12, 0.33
"""Lift of the swinging foot, metres; radians that its toes point down first and up later."""
_ARM_SWING, _ELBOW = 0.5, 0.35
WHEEL_RADIUS = 0.34
"""Radius of the wheels, metres."""
GEAR = 2.4
"""Turns of the wheels to one of the cranks."""
_REAR, _FRONT = -0.45, 0.57
_CRANKS = np.array([0.0, 0.0, 0.29])
_CRANK = 0.165
_PEDAL = 0.11
"""Metres of a pedal's middle from the bicycle's plane."""
_SADDLE = np.array([-0.2, 0.0, 0.96])
_GRIP = np.array([0.4, 0.25, 1.03])
_SPOKES = 9
_BLACK, _STEEL, _AMBER = (0.02, 0.02, 0.02), (0.35, 0.36, 0.38), (0.8, 0.25, 0.02)


@dataclass(frozen=True)
class Walk:
    """A walk; its feet do not slip: while one is down it moves back as fast as the body ahead."""

    look: PersonLook  # look of the person
    pack: tuple[float, float, float] | None = None  # linear RGB of a backpack, None without one

    @property
    def cycle(self) -> float:
        """Metres of two steps."""
        return _STRIDE * self.look.height

    @cached_property
    def parts(self) -> Sequence[Surface]:
        """Shapes, in the order of `poses`."""
        look, size = self.look, self.look.height
        legs = 2 * leg(look, 0.245 * size, 0.245 * size)
        arms = 2 * arm(look, 0.165 * size, 0.145 * size)
        middle = [trunk(look, 0.26 * size), head(look), hair(look)]
        pelvis = ball((0.105 * look.girth, 0.15 * look.girth, 0.1), look.trousers, "fabric")
        bag = [] if self.pack is None else [ball((0.1, 0.15, 0.22), self.pack, "fabric")]
        return (*legs, *arms, *middle, pelvis, *bag)

    def poses(self, travelled: float) -> Sequence[Array]:
        """`body_from_part` (4, 4) of each part after `travelled` metres."""
        size, phase = self.look.height, travelled / self.cycle
        found: list[Array] = []
        thigh = shin = 0.245 * size
        ankle = ankle_height(self.look)
        feet = [self._foot(phase % 1.0), self._foot((phase + 0.5) % 1.0)]
        # As high as both legs reach, and as both would where a foot is farthest: hips go up and
        # down by the mean of the two.
        reach = 0.995 * (thigh + shin)
        least = np.sqrt(reach**2 - (STANCE * self.cycle / 2) ** 2)
        most = min(lift + np.sqrt(reach**2 - ahead**2) for ahead, lift, _ in feet)
        hip_height = ankle + (least + most) / 2
        for side, (ahead, lift, tip) in zip((1, -1), feet, strict=True):
            hip = np.array([0.0, side * 0.052 * size, hip_height])
            end = np.array([ahead, side * 0.045 * size, ankle + lift])
            knee = middle_joint(hip, end, thigh, shin, (1.0, 0.0, 0.0))
            found += [between(hip, knee), between(knee, end), turned(tip, end)]
        shoulders = hip_height + 0.29 * size
        for side, own in ((1, phase), (-1, phase + 0.5)):
            swing = -_ARM_SWING * np.cos(2 * np.pi * own)
            shoulder = np.array([0.0, side * 0.118 * size, shoulders])
            elbow = shoulder + 0.165 * size * _down(swing)
            wrist = elbow + 0.145 * size * _down(swing + _ELBOW)
            found += [between(shoulder, elbow), between(elbow, wrist)]
            found.append(between(wrist, wrist + _down(swing + _ELBOW)))
        found.append(between((0.015, 0.0, shoulders - 0.02), (0.0, 0.0, hip_height)))
        crown = np.array([0.035, 0.0, shoulders + 0.11 * size])
        found += [_at(crown), _at(crown), _at((0.0, 0.0, hip_height + 0.01))]
        if self.pack is not None:
            found.append(_at((-0.17, 0.0, shoulders - 0.2)))
        return found

    def _foot(self, phase: float) -> tuple[float, float, float]:
        """Metres ahead of the hips, metres above the ground, radians that the toes point down."""
        step = STANCE * self.cycle
        if phase < STANCE:
            return step / 2 - self.cycle * phase, 0.0, 0.0
        p = (phase - STANCE) / (1 - STANCE)
        # Hermite's cubic: the foot leaves and meets the ground at the speed of the ground.
        slope = -self.cycle * (1 - STANCE)
        ahead = -step / 2 * (1 - 3 * p**2 + 2 * p**3) + step / 2 * (3 * p**2 - 2 * p**3)
        ahead += slope * (p - 2 * p**2 + p**3) + slope * (p**3 - p**2)
        scale = self.look.height / 1.75
        return (
            ahead,
            scale * _LIFT * float(np.sin(np.pi * p)),
            _TIP * float(np.sin(2 * np.pi * p)),
        )


def _down(angle: float) -> Array:
    """(3,) unit vector: down, turned forward by `angle` radians."""
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def _at(place: Sequence[float] | Array) -> Array:
    return turned(0.0, place)


@dataclass(frozen=True)
class Ride:
    """A ride without freewheeling; wheels roll without slipping."""

    look: PersonLook  # look of the rider
    frame: Colour  # linear RGB of the bicycle's frame

    @property
    def cycle(self) -> float:
        """Metres of one turn of the cranks; wheels look the same from outside at any angle."""
        return 2 * np.pi * WHEEL_RADIUS * GEAR

    @cached_property
    def parts(self) -> Sequence[Surface]:
        """Shapes, in the order of `poses`."""
        look = self.look
        thigh, shin, upper, fore, back = self._lengths()
        limbs = *2 * leg(look, thigh, shin), *2 * arm(look, upper, fore)
        rider = (trunk(look, back), head(look), hair(look))
        wheel = _wheel()
        return (_frame(self.frame), wheel, wheel, _crank(), *limbs, *rider)

    def poses(self, travelled: float) -> Sequence[Array]:
        """`body_from_part` (4, 4) of each part after `travelled` metres."""
        roll, crank = travelled / WHEEL_RADIUS, travelled / (WHEEL_RADIUS * GEAR)
        thigh, shin, upper, fore, back = self._lengths()
        found = [
            np.eye(4),
            turned(roll, (_REAR, 0.0, WHEEL_RADIUS)),
            turned(roll, (_FRONT, 0, WHEEL_RADIUS)),
        ]
        found.append(turned(crank, _CRANKS))
        ankle = ankle_height(self.look)
        hips = _SADDLE + np.array([0.03, 0.0, 0.05])
        for side in (1, -1):
            # At angle 0 the left pedal is up.
            turn = crank if side == 1 else crank + np.pi
            pedal = _CRANKS + _CRANK * np.array([np.sin(turn), 0.0, np.cos(turn)])
            end = pedal + np.array([-0.05, side * _PEDAL, ankle + 0.012])
            hip = hips + np.array([0.0, side * 0.09, 0.0])
            knee = middle_joint(hip, end, thigh, shin, (1.0, 0.0, 0.3))
            found += [between(hip, knee), between(knee, end), turned(0.12, end)]
        lean = np.deg2rad(32)
        shoulders = hips + back * np.array([np.sin(lean), 0.0, np.cos(lean)])
        for side in (1, -1):
            shoulder = shoulders + np.array([0.0, side * 0.19, -0.03])
            wrist = _GRIP * [1.0, side, 1.0] + np.array([-0.03, 0.0, 0.05])
            elbow = middle_joint(shoulder, wrist, upper, fore, (-0.2, 0.6 * side, -1.0))
            found += [between(shoulder, elbow), between(elbow, wrist)]
            found.append(between(wrist, wrist + np.array([0.6, 0.0, -0.8])))
        found.append(between(shoulders, hips))
        crown = shoulders + np.array([0.1, 0.0, 0.11 * self.look.height])
        return [*found, turned(0.1, crown), turned(0.1, crown)]

    def _lengths(self) -> tuple[float, float, float, float, float]:
        """Metres of thigh, shin, upper arm, forearm and back."""
        size = self.look.height
        return 0.245 * size, 0.25 * size, 0.17 * size, 0.155 * size, 0.28 * size


def _wheel() -> Surface:
    """A wheel about the origin that turns about y, with spokes and one reflector."""
    turn = np.linspace(-np.pi, np.pi, 7)
    tyre = [WHEEL_RADIUS - 0.02, 0.0] + 0.02 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    parts = [lathe(tyre, 28, _BLACK, "rubber")]
    parts.append(
        lathe([[0.0, -0.05], [0.025, -0.05], [0.025, 0.05], [0.0, 0.05]], 8, _STEEL, "metal")
    )
    for angle in 2 * np.pi * np.arange(_SPOKES) / _SPOKES:
        ray = np.array([np.cos(angle), np.sin(angle), 0.0])
        parts.append(tube([0.02 * ray, (WHEEL_RADIUS - 0.03) * ray], 0.006, 4, _STEEL, "metal"))
    low, high = np.array([0.16, -0.03, -0.02]), np.array([0.22, 0.03, 0.02])
    parts.append(boxes(low, high, _AMBER, "taillamp"))
    upright = np.eye(4)
    upright[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # z of the lathe to y of the bicycle
    return concatenate(parts).transformed(upright)


def _crank() -> Surface:
    """Both arms and pedals about the origin, the left arm up."""
    parts = [tube([[0, -_PEDAL, 0], [0, _PEDAL, 0]], 0.018, 6, _STEEL, "metal")]
    for side in (1, -1):
        end = np.array([0.0, side * 0.06, side * _CRANK])
        parts.append(tube([end * [0, 1, 0], end], 0.013, 4, _STEEL, "metal"))
        low = np.array([-0.045, side * _PEDAL - 0.045, side * _CRANK - 0.012])
        parts.append(boxes(low, low + np.array([0.09, 0.09, 0.024]), _BLACK, "plastic"))
    return concatenate(parts)


def _frame(colour: Colour) -> Surface:
    """Frame, fork, saddle, handlebar and lamp."""
    seat, neck = _SADDLE - [-0.03, 0.0, 0.06], np.array([0.4, 0.0, 0.88])
    rear, front = np.array([_REAR, 0.0, WHEEL_RADIUS]), np.array([_FRONT, 0.0, WHEEL_RADIUS])
    low = np.array([0.43, 0.0, 0.72])
    bars = [(_CRANKS, seat), (_CRANKS, low), (seat - [0, 0, 0.12], neck), (low, neck)]
    parts = [tube(bar, 0.019, 6, colour, "paint") for bar in bars]
    for side in (0.045, -0.045):
        aside = np.array([0.0, side, 0.0])
        stays = [(_CRANKS, rear + aside), (seat - [0, 0, 0.1], rear + aside), (low, front + aside)]
        parts += [tube(stay, 0.011, 4, colour, "paint") for stay in stays]
    parts.append(tube([seat, _SADDLE - [0, 0, 0.03]], 0.014, 6, _STEEL, "metal"))
    parts.append(
        boxes(_SADDLE - [0.13, 0.07, 0.04], _SADDLE + np.array([0.13, 0.07, 0]), _BLACK, "plastic")
    )
    stem = np.array([0.385, 0.0, 1.02])
    parts.append(tube([neck, stem], 0.015, 6, _STEEL, "metal"))
    parts.append(tube([_GRIP * [1, -1, 1], stem, _GRIP], 0.014, 6, _BLACK, "plastic"))
    parts.append(boxes([0.45, -0.03, 0.86], [0.5, 0.03, 0.92], (0.9, 0.9, 0.85), "headlamp"))
    return concatenate(parts)
