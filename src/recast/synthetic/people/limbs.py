"""Rigid limbs between joints: their shapes, and where two of them meet (inverse kinematics)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.synthetic.scenery.primitives import lathe
from recast.synthetic.surface import Surface, concatenate

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

_FORWARD = np.array([1.0, 0.0, 0.0])
_SIDES = 10


def limb(
    length: float,
    upper: float,
    lower: float,
    colour: Colour,
    *,
    flat: float = 1.0,
    material: str = "fabric",
) -> Surface:
    """A limb with round ends from the origin down to z = -length.

    Args:
        length: distance of its two joints, metres.
        upper, lower: radii at the joints, metres; the round ends reach beyond them.
        colour: linear RGB.
        flat: factor of the extent along x.
        material: a name in `MATERIALS`.
    """
    turn = np.linspace(-np.pi / 2, np.pi / 2, 7)
    low = np.stack([lower * np.cos(turn[:4]), -length + lower * np.sin(turn[:4])], axis=1)
    high = np.stack([upper * np.cos(turn[3:]), upper * np.sin(turn[3:])], axis=1)
    profile = np.concatenate([low, high])
    profile[[0, -1], 0] = 0.0
    return scaled(lathe(profile, _SIDES, colour, material), (flat, 1.0, 1.0))


def ball(radii: Sequence[float], colour: Colour, material: str = "matte") -> Surface:
    """An ellipsoid about the origin with these half axes along x, y and z, metres."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 8)
    profile = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    profile[[0, -1], 0] = 0.0
    return scaled(lathe(profile, 12, colour, material), radii)


def scaled(surface: Surface, factors: Sequence[float]) -> Surface:
    """A surface stretched along its axes by positive factors."""
    scale = np.asarray(factors, np.float64)
    normals = surface.normals / scale
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Surface(
        surface.vertices * scale,
        surface.faces,
        normals.astype(np.float32),
        surface.colours,
        surface.materials,
    )


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
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(left, up), left, up], axis=1)
    pose[:3, 3] = start
    return pose


def turned(angle: float, place: ArrayLike) -> Array:
    """Pose (4, 4) at `place` (3,), turned by `angle` radians about y: z towards x."""
    pose = np.eye(4)
    cos, sin = np.cos(angle), np.sin(angle)
    pose[:3, :3] = [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]
    pose[:3, 3] = place
    return pose


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
    joint: Array = root + along * axis + np.sqrt(upper**2 - along**2) * bend
    return joint


def assembled(parts: Sequence[Surface], poses: Sequence[Array], shift: Array) -> Surface:
    """Parts at poses (4, 4), all moved by `shift` (3,)."""
    offset = np.eye(4)
    offset[:3, 3] = shift
    placed = [part.transformed(offset @ at) for part, at in zip(parts, poses, strict=True)]
    return concatenate(placed)
