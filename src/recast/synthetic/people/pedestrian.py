"""A walking pedestrian: planted feet, knees bent as they must be, arms against the legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.people import body
from recast.synthetic.people.body import Look
from recast.synthetic.people.limbs import ball, between, middle_joint, turned
from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

STANCE = 0.58
"""Share of a cycle during which a foot is on the ground; 0.6 in people who walk at leisure."""
_STRIDE = 0.74
"""Metres of way in a cycle (two steps) to the body's height."""
_LIFT, _TIP = 0.12, 0.33
"""Of the swinging foot: metres, and radians that its toes point down first and up later."""
_ARM_SWING, _ELBOW = 0.5, 0.35


@dataclass(frozen=True)
class Walk:
    """A walk; its feet do not slip: while a foot is down it moves back as fast as the body ahead.

    Attributes:
        look: of the person.
        pack: linear RGB of a backpack, None without one.
    """

    look: Look
    pack: tuple[float, float, float] | None = None

    @property
    def cycle(self) -> float:
        """Metres of two steps."""
        return _STRIDE * self.look.height

    @cached_property
    def parts(self) -> Sequence[Surface]:
        """Shapes, in the order of `poses`."""
        look, size = self.look, self.look.height
        leg = (
            body.upper_leg(look, 0.245 * size),
            body.lower_leg(look, 0.245 * size),
            body.foot(look),
        )
        arm = (
            body.upper_arm(look, 0.165 * size),
            body.lower_arm(look, 0.145 * size),
            body.hand(look),
        )
        middle = [body.trunk(look, 0.26 * size), body.head(look), body.hair(look)]
        pelvis = ball((0.105 * look.girth, 0.15 * look.girth, 0.1), look.trousers, "fabric")
        bag = [] if self.pack is None else [ball((0.1, 0.15, 0.22), self.pack, "fabric")]
        return (*leg, *leg, *arm, *arm, *middle, pelvis, *bag)

    def poses(self, travelled: float) -> Sequence[Array]:
        """`body_from_part` (4, 4) of each part after `travelled` metres."""
        size, phase = self.look.height, travelled / self.cycle
        found: list[Array] = []
        thigh = shin = 0.245 * size
        ankle = body.ankle_height(self.look)
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
