"""A person's surface in patches, and where its parts are at every phase of a walk or a ride.

Lengths of limbs are shares of the height (Winter, Biomechanics and Motor Control of Human Movement,
4th ed., figure 4.1, after Drillis and Contini). Angles of hip, knee and ankle are those of level
walking at a natural cadence, as gait laboratories publish them (ibid., appendix A), rounded.
Frames of parts: x ahead, y left, z up when the person stands; a limb hangs down from its joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial import cKDTree

from recast.arrays import Array, Int64Array
from recast.geometry import se3

PHASES = 48
"""Phases at which a gait is worked out; between them it is interpolated."""
WHEEL_RADIUS = 0.34
"""Radius of the wheels of an adult's bicycle with tyres, metres (ISO 622)."""
STRIDE = 0.8
"""Metres of two steps, over the height, at a natural speed."""
DEVELOPMENT = 5.2
"""Metres that a bicycle rolls in a turn of its cranks, in a middle gear."""


class Region(IntEnum):
    """What a patch is of: neighbours of one region look alike."""

    SKIN, HAIR, TOP, TROUSERS, SHOES, PACK, FRAME, TYRE, METAL = range(9)


@dataclass(frozen=True)
class PersonShape:
    """What tells one body from another.

    Attributes:
        height: metres, standing.
        girth: factor of the thickness of trunk and limbs.
        pack: whether a bag hangs on the back.
        bicycle: length of the bicycle that is ridden, metres; 0 for a pedestrian.
        top: metres from the ground to the crown of a cyclist.
        cycle: metres of way in two steps, or in a turn of the cranks.
    """

    height: float
    girth: float = 1.0
    pack: bool = False
    bicycle: float = 0.0
    top: float = 0.0
    cycle: float = 1.4


# Shares of the height.
_HIP, _SHOULDER, _CROWN = 0.530, 0.818, 1.0
_THIGH, _SHIN, _ANKLE = 0.245, 0.246, 0.039
_UPPER_ARM, _FOREARM = 0.186, 0.146
_HIP_SIDE, _SHOULDER_SIDE = 0.052, 0.112
_TRUNK = _SHOULDER - _HIP
_HEEL, _TOE = -0.045, 0.107
_HEAD = (0.057, 0.045, 0.070)  # halves of its extents

_SPINE, _HEADPART = 0, 1
_SIDES = ((1, 2), (-1, 7))  # sign of y, and number of the first of its five parts
_BIKE, _REAR, _FRONT, _CRANK = 12, 13, 14, 15
_PARENTS = (-1, 0, 0, 2, 3, 0, 5, 0, 7, 8, 0, 10, -1, -1, -1, -1)

# Degrees by shares of a cycle from the heel's contact on: flexion of the hip and of the knee,
# dorsiflexion of the ankle.
_SHARES = (0.0, 0.08, 0.16, 0.30, 0.42, 0.52, 0.62, 0.73, 0.85, 0.95, 1.0)
_HIP_ANGLES = (26, 25, 20, 6, -6, -11, -4, 15, 28, 28, 26)
_KNEE_ANGLES = (4, 13, 18, 10, 7, 16, 42, 63, 42, 8, 4)
_ANKLE_ANGLES = (0, -5, 1, 7, 10, 3, -16, -6, 2, 1, 0)
_ARM_SWING, _ELBOW = 22.0, 25.0
_STEEPEST, _FLATTEST = 8.0, 55.0  # degrees of a rider's trunk from the vertical
_BOTTOM = (0.43, 0.28)  # metres of the cranks' axle ahead of the rear wheel's, and above the ground
_CRANK_ARM, _PEDAL, _SETBACK = 0.17, 0.11, 0.2
_FINER = 0.6  # of the spacing, on a bicycle's bars
_TYRE = 0.016  # half of its thickness
_GRIP = (-0.18, 0.24, 1.0)  # metres from above the front axle, to the side, and above the ground


def _pitch(angle: float, place: ArrayLike = (0, 0, 0)) -> Array:
    """Pose (4, 4) turned by radians that lift what points ahead, and swing ahead what hangs."""
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]
    return se3.from_rotation_translation(rotation, place)


def _hanging(start: Array, end: Array) -> Array:
    """Pose (4, 4) of a limb from one joint to another, its x axis as far ahead as can be."""
    up = (start - end) / np.linalg.norm(start - end)
    left = np.cross(up, [1.0, 0.0, 0.0])
    left = left / np.linalg.norm(left) if np.linalg.norm(left) > 1e-6 else np.array([0.0, 1.0, 0])
    rotation = np.stack([np.cross(left, up), left, up], axis=1)
    return se3.from_rotation_translation(rotation, start)


def _bent(start: Array, end: Array, upper: float, lower: float, towards: Array) -> Array:
    """Place (3,) of the joint between two limbs: a triangle of their lengths (law of cosines)."""
    reach = min(float(np.linalg.norm(end - start)), 0.999 * (upper + lower))
    axis = (end - start) / np.linalg.norm(end - start)
    along = (upper**2 - lower**2 + reach**2) / (2 * reach)
    aside = towards - (towards @ axis) * axis
    aside /= np.linalg.norm(aside)
    return start + along * axis + np.sqrt(max(upper**2 - along**2, 0.0)) * aside


@cache
def _angle_curves() -> CubicSpline:
    angles = np.radians([_HIP_ANGLES, _KNEE_ANGLES, _ANKLE_ANGLES]).T
    return CubicSpline(_SHARES, angles, bc_type="periodic")


def part_poses(shape: PersonShape, phase: float) -> Array:
    """Poses (J, 4, 4) `body_from_part` at a phase in cycles; the body stands on z = 0."""
    return _riding(shape, phase) if shape.bicycle else _walking(shape, phase)


def _walking(shape: PersonShape, phase: float) -> Array:
    """Two steps a cycle, the left foot's contact at phase 0; the lower foot is on the ground."""
    size = shape.height
    # Longer steps, wider angles, nearly in proportion; knees bend for short ones, too.
    stretch = float(np.clip(shape.cycle / (STRIDE * size), 0.3, 1.4))
    scale = np.array([stretch, np.sqrt(stretch), np.sqrt(stretch)])
    poses = np.tile(np.eye(4), (12, 1, 1))
    lowest = np.inf
    for (sign, first), own in zip(_SIDES, (phase, phase + 0.5), strict=True):
        hip, knee, ankle = scale * _angle_curves()(own % 1.0)
        start = np.array([0.0, sign * _HIP_SIDE * size, 0.0])
        poses[first] = _pitch(hip, start)
        poses[first + 1] = poses[first] @ _pitch(-knee, (0, 0, -_THIGH * size))
        poses[first + 2] = poses[first + 1] @ _pitch(ankle, (0, 0, -_SHIN * size))
        sole = size * np.array([[_HEEL, 0, -_ANKLE], [_TOE, 0, -_ANKLE]])
        lowest = min(lowest, float(se3.apply(poses[first + 2], sole)[:, 2].min()))
        swing = -stretch * np.radians(_ARM_SWING) * np.cos(2 * np.pi * own)
        shoulder = np.array([0.0, sign * _SHOULDER_SIDE * size, _TRUNK * size])
        poses[first + 3] = _pitch(swing, shoulder)
        bend = np.radians(_ELBOW) * (1 + 0.4 * np.sin(swing))
        poses[first + 4] = poses[first + 3] @ _pitch(bend, (0, 0, -_UPPER_ARM * size))
    poses[_HEADPART, :3, 3] = size * np.array([0.012, 0.0, _CROWN - _HEAD[2] - _HIP])
    poses[:, 2, 3] -= lowest
    return poses


def _riding(shape: PersonShape, phase: float) -> Array:
    """A turn of the cranks a cycle, the left pedal up at phase 0, wheels that do not slip."""
    size, rear = shape.height, -shape.bicycle / 2 + WHEEL_RADIUS
    front = shape.bicycle / 2 - WHEEL_RADIUS
    poses = np.tile(np.eye(4), (16, 1, 1))
    rolled = shape.cycle * phase / WHEEL_RADIUS
    poses[_REAR] = _pitch(-rolled, (rear, 0, WHEEL_RADIUS))
    poses[_FRONT] = _pitch(-rolled, (front, 0, WHEEL_RADIUS))
    bottom = np.array([rear + _BOTTOM[0], 0.0, _BOTTOM[1]])
    turn = 2 * np.pi * phase
    poses[_CRANK] = _pitch(-turn, bottom)
    # The saddle is as high as the leg reaches to the lower pedal, a little bent.
    leg = 0.96 * (_THIGH + _SHIN) * size
    high = np.sqrt(max(leg**2 - _SETBACK**2, 0.09)) - _CRANK_ARM + _ANKLE * size
    hips = bottom + np.array([-_SETBACK, 0.0, high])
    lean = _lean(shape, hips[2])
    shoulders = hips + _TRUNK * size * np.array([np.sin(lean), 0.0, np.cos(lean)])
    poses[_SPINE] = _pitch(-lean, hips)
    above = (_CROWN - _HEAD[2] - _SHOULDER) * size
    poses[_HEADPART, :3, 3] = shoulders + above * np.array([np.sin(0.6 * lean), 0, np.cos(lean)])
    bar = _handlebar(shape, shoulders)
    for (sign, first), crank in zip(_SIDES, (turn, turn + np.pi), strict=True):
        aside = np.array([0.0, sign, 0.0])
        pedal = bottom + _CRANK_ARM * np.array([np.sin(crank), 0, np.cos(crank)])
        ankle = pedal + _PEDAL * aside + [-0.06 * size, 0.0, _ANKLE * size]
        hip = hips + _HIP_SIDE * size * aside
        knee = _bent(hip, ankle, _THIGH * size, _SHIN * size, np.array([1.0, 0.0, 0.3]))
        poses[first], poses[first + 1] = _hanging(hip, knee), _hanging(knee, ankle)
        poses[first + 2, :3, 3] = ankle
        shoulder = shoulders + _SHOULDER_SIDE * size * aside
        grip = np.array([bar, sign * _GRIP[1], _GRIP[2] + 0.04])
        down = np.array([-0.2, 0.5 * sign, -1.0])
        elbow = _bent(shoulder, grip, _UPPER_ARM * size, _FOREARM * size, down)
        poses[first + 3], poses[first + 4] = _hanging(shoulder, elbow), _hanging(elbow, grip)
    return poses


def _handlebar(shape: PersonShape, shoulders: Array) -> float:
    """Metres ahead of the middle to the grips, as far as a rider's arms reach to them."""
    down = shoulders[2] - _GRIP[2] - 0.04
    across = _GRIP[1] - _SHOULDER_SIDE * shape.height
    arm = 0.97 * (_UPPER_ARM + _FOREARM) * shape.height
    reach = np.sqrt(max(arm**2 - down**2 - across**2, 0.0))
    return float(min(shape.bicycle / 2 - WHEEL_RADIUS + _GRIP[0], shoulders[0] + reach))


def _lean(shape: PersonShape, hips: float) -> float:
    """Radians from the vertical of a rider's trunk, by where its crown is."""
    upright = (_CROWN - _HIP) * shape.height
    cosine = (shape.top - hips) / upright if shape.top else 0.9
    return float(np.arccos(np.clip(cosine, *np.cos(np.radians([_FLATTEST, _STEEPEST])))))


@dataclass(frozen=True)
class BodySurface:
    """N patches of a person (and bicycle) at the first phase, body frame, metres."""

    # points, normals: (N, 3), normals outward.
    points: Array
    normals: Array
    spacing: Array  # (N,) edge of each patch
    region: Int64Array  # (N,) `Region`
    weights: Array  # (N, J) of the parts in each patch's motion; rows add up to 1
    twin: Int64Array  # (N,) the patch on the other side of the body
    motions: Array  # (T, J, 4, 4) motion of each part from the first phase to each


class Piece(NamedTuple):
    """A part of the surface that moves with a part of the body."""

    part: int
    points: Array  # (N, 3) in the part's frame
    normals: Array  # (N, 3)
    region: Array | int  # (N,) or of all, `Region`
    radius: float = 0.0  # metres around the joint above within which it bends; 0 if it is stiff
    finer: float = 1.0  # share of the spacing that its patches have
    sign: float = 1.0  # factor of y: -1 on the right


def surface_of(shape: PersonShape, spacing: float) -> BodySurface:
    """Cover a body with patches about `spacing` metres apart."""
    frames = np.stack([part_poses(shape, k / PHASES) for k in range(PHASES)])
    rest = frames[0]
    pieces = [*_trunk(shape, spacing), *_head(shape, spacing)]
    middle, limbs = len(pieces), [*_leg(shape, spacing), *_arm(shape, spacing)]
    for sign, first in _SIDES:
        pieces += [limb._replace(part=first + limb.part, sign=float(sign)) for limb in limbs]
    if shape.bicycle:
        pieces += _bicycle(shape, rest, spacing)
    counts = [len(piece.points) for piece in pieces]
    numbers = np.repeat(np.arange(len(pieces)), counts)
    places, normals, weights = [], [], []
    for piece in pieces:
        side = np.array([1.0, piece.sign, 1.0])
        places.append(se3.apply(rest[piece.part], piece.points * side))
        normals.append((piece.normals * side) @ rest[piece.part, :3, :3].T)
        weights.append(_weights(piece, len(rest)))
    regions = [np.broadcast_to(piece.region, len(piece.points)) for piece in pieces]
    local = np.concatenate([piece.points for piece in pieces])
    return BodySurface(
        np.concatenate(places),
        np.concatenate(normals),
        spacing * np.repeat([piece.finer for piece in pieces], counts),
        np.concatenate(regions).astype(np.int64),
        np.concatenate(weights),
        _twins(numbers, local, middle, len(limbs)),
        frames @ se3.inverse(rest),
    )


def _twins(numbers: Int64Array, local: Array, middle: int, limbs: int) -> Int64Array:
    """The other limb's patch of the same place; of a piece in the middle, the nearest mirrored."""
    twin = np.arange(len(numbers))
    for piece in range(int(numbers.max()) + 1):
        own = np.flatnonzero(numbers == piece)
        if middle <= piece < middle + 2 * limbs:
            other = piece + limbs if piece < middle + limbs else piece - limbs
            twin[own] = np.flatnonzero(numbers == other)
        else:
            twin[own] = own[cKDTree(local[own]).query(local[own] * [1, -1, 1])[1]]
    return twin


def _weights(piece: Piece, parts: int) -> Array:
    """Weights (N, J): around a joint, a patch moves with the limbs on both sides of it."""
    weights = np.zeros((len(piece.points), parts))
    weights[:, piece.part] = 1.0
    if piece.radius > 0:
        share = np.clip(0.5 + piece.points[:, 2] / (2 * piece.radius), 0.0, 1.0)
        weights[:, _PARENTS[piece.part]] = share
        weights[:, piece.part] -= share
    return weights


def _loft(rows: ArrayLike, spacing: float) -> tuple[Array, Array]:
    """Points and normals (N, 3) of ellipses one above the other.

    Args:
        rows: (R, 4) height, halves of the extent ahead and aside, and metres ahead of the middle.
    """
    rows = np.asarray(rows, np.float64)
    steps = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    curve = PchipInterpolator(along, rows)
    count = max(int(np.ceil(along[-1] / spacing)), 2)
    places, normals = [], []
    for number, t in enumerate((np.arange(count) + 0.5) / count * along[-1]):
        (z, ahead, aside, shift), (climbs, widens, flares, _) = curve(t), curve(t, 1)
        around = np.pi * (3 * (ahead + aside) - np.sqrt((3 * ahead + aside) * (ahead + 3 * aside)))
        turns = 2 * max(int(np.ceil(around / spacing / 2)), 2)
        # Every second ring half a patch on; symmetric about y = 0 both ways.
        angle = 2 * np.pi * (np.arange(turns) + 0.5 * (number % 2)) / turns
        cos, sin = np.cos(angle), np.sin(angle)
        places.append(np.stack([shift + ahead * cos, aside * sin, np.full(turns, z)], axis=-1))
        flat = np.stack([cos / max(ahead, 1e-4), sin / max(aside, 1e-4)], axis=-1)
        flat *= abs(climbs) / np.linalg.norm(flat, axis=1, keepdims=True)
        rises = -np.sign(climbs) * (widens * cos**2 + flares * sin**2)
        normals.append(np.column_stack([flat, rises]))
    normal = np.concatenate(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return np.concatenate(places), normal


def _ball(radii: ArrayLike, spacing: float, middle: ArrayLike = (0, 0, 0)) -> tuple[Array, Array]:
    """Points and normals (N, 3) of an ellipsoid."""
    radii = np.asarray(radii, np.float64)
    tilt = np.linspace(-np.pi / 2, np.pi / 2, 9)
    rows = np.stack(
        [radii[2] * np.sin(tilt), radii[0] * np.cos(tilt), radii[1] * np.cos(tilt), 0 * tilt], -1
    )
    points, _ = _loft(rows, spacing)
    normals = points / radii**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points + np.asarray(middle, np.float64), normals


def _limb(length: float, radii: tuple[float, float, float], spacing: float) -> tuple[Array, Array]:
    """A limb with round ends, `radii` at its joint, at a third and at the end, metres."""
    upper, third, lower = radii
    turn = np.radians([80, 45, 0])
    top = [[upper * np.sin(a), upper * np.cos(a), upper * np.cos(a), 0] for a in turn]
    middle = [[-length / 3, third, third, 0]]
    bottom = [[-length - lower * np.sin(a), *2 * [lower * np.cos(a)], 0] for a in turn[::-1]]
    return _loft([*top, *middle, *bottom], spacing)


def _trunk(shape: PersonShape, spacing: float) -> list[Piece]:
    """Hips and chest: height over the hips, halves ahead and aside, shift; shares of the height."""
    size, girth = shape.height, shape.girth
    rows = np.array(
        [
            [-0.065, 0.020, 0.030, 0.0],
            [-0.055, 0.050, 0.075, -0.004],
            [-0.010, 0.066, 0.094, -0.006],
            [0.060, 0.062, 0.088, 0.0],
            [0.120, 0.062, 0.086, 0.004],
            [0.200, 0.068, 0.098, 0.002],
            [0.255, 0.060, 0.104, -0.002],
            [0.290, 0.042, 0.080, -0.002],
            [0.306, 0.028, 0.035, 0.004],
        ]
    )
    rows[:, 1:3] *= girth
    points, normals = _loft(rows * size, spacing)
    region = np.where(points[:, 2] < 0.045 * size, Region.TROUSERS, Region.TOP)
    pieces: list[Piece] = [Piece(_SPINE, points, normals, region)]
    if shape.pack:
        radii = size * np.array([0.062, 0.088, 0.125])
        middle = size * np.array([-0.062 * girth - 0.045, 0.0, 0.17])
        pieces.append(Piece(_SPINE, *_ball(radii, spacing, middle), Region.PACK))
    return pieces


def _head(shape: PersonShape, spacing: float) -> list[Piece]:
    size = shape.height
    points, normals = _ball(size * np.array(_HEAD), spacing)
    x, _, z = (points / (size * np.array(_HEAD))).T
    region = np.where((x < -0.15) & (z > -0.6) | (z > 0.62), Region.HAIR, Region.SKIN)
    neck = _loft(
        size * np.array([[-0.02, 0.03, 0.031, -0.012], [-0.125, 0.034, 0.036, -0.018]]), spacing
    )
    return [
        Piece(_HEADPART, points, normals, region),
        Piece(_HEADPART, *neck, Region.SKIN),
    ]


def _leg(shape: PersonShape, spacing: float) -> list[Piece]:
    """Thigh, shin and foot; part numbers from the first of the side on."""
    size, girth = shape.height, shape.girth * shape.height
    thigh = _limb(_THIGH * size, (0.049 * girth, 0.046 * girth, 0.033 * girth), spacing)
    shin = _limb(_SHIN * size, (0.033 * girth, 0.034 * girth, 0.022 * girth), spacing)
    long, middle = (_TOE - _HEEL) / 2 * size, (_TOE + _HEEL) / 2 * size
    foot = _ball(
        (long, 0.028 * size, 0.027 * size), spacing, (middle, 0.0, (0.027 - _ANKLE) * size)
    )
    return [
        Piece(0, *thigh, Region.TROUSERS, 0.05 * size),
        Piece(1, *shin, Region.TROUSERS, 0.035 * size),
        Piece(2, *foot, Region.SHOES),
    ]


def _arm(shape: PersonShape, spacing: float) -> list[Piece]:
    """Upper arm, forearm and hand."""
    size, girth = shape.height, shape.girth * shape.height
    upper = _limb(_UPPER_ARM * size, (0.032 * girth, 0.029 * girth, 0.024 * girth), spacing)
    fore = _limb(_FOREARM * size, (0.024 * girth, 0.024 * girth, 0.018 * girth), spacing)
    middle = np.array([0.0, 0.0, -(_FOREARM + 0.045) * size])
    hand = _ball(size * np.array([0.022, 0.014, 0.05]), spacing, middle)
    return [
        Piece(3, *upper, Region.TOP, 0.03 * size),
        Piece(4, *fore, Region.TOP, 0.024 * size),
        Piece(4, *hand, Region.SKIN),
    ]


def _tube(start: ArrayLike, end: ArrayLike, radius: float, spacing: float) -> tuple[Array, Array]:
    """Points and normals (N, 3) of a bar."""
    start, end = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(end - start))
    points, normals = _loft([[0, radius, radius, 0], [-length, radius, radius, 0]], spacing)
    pose = _hanging(start, end)
    return se3.apply(pose, points), normals @ pose[:3, :3].T


def _bicycle(shape: PersonShape, rest: Array, spacing: float) -> list[Piece]:
    """Frame, wheels and cranks, by the poses (J, 4, 4) of the first phase."""
    rear, front, bottom = (rest[k, :3, 3] for k in (_REAR, _FRONT, _CRANK))
    seat = rest[_SPINE, :3, 3] - [0.0, 0.0, 0.09]
    below = seat - [0.0, 0.0, 0.1]
    shoulders = rest[_SPINE] @ [0.0, 0.0, _TRUNK * shape.height, 1.0]
    neck = front - [0.16, 0.0, -0.52]
    grip = np.array([_handlebar(shape, shoulders[:3]), 0.0, _GRIP[2]])
    under, reach = neck - [-0.03, 0.0, 0.14], np.array([0.0, _GRIP[1] + 0.06, 0.0])
    fine = _FINER * spacing
    bars = [(bottom, seat, 0.018), (bottom, under, 0.02), (below, neck, 0.018)]
    for aside in (np.array([0.0, 0.05, 0.0]), np.array([0.0, -0.05, 0.0])):
        bars += [(bottom, rear + aside, 0.011), (below, rear + aside, 0.011)]
        bars.append((under, front + aside, 0.012))
    fittings = [(grip + reach, grip - reach, 0.014), (neck, grip, 0.014)]
    pieces = [Piece(_BIKE, *_tube(*bar, fine), Region.FRAME, finer=_FINER) for bar in bars]
    pieces += [Piece(_BIKE, *_tube(*bar, fine), Region.METAL, finer=_FINER) for bar in fittings]
    pieces.append(Piece(_BIKE, *_ball((0.13, 0.07, 0.03), spacing, seat), Region.TYRE))
    for wheel in (_REAR, _FRONT):
        pieces.append(Piece(wheel, *_tyre(fine), Region.TYRE, finer=_FINER))
    for sign in (1.0, -1.0):
        pedal = np.array([0.0, sign * _PEDAL, sign * _CRANK_ARM])
        arm = _tube([0.0, pedal[1] / 2, 0.0], pedal * [1, 0.5, 1], 0.012, spacing)
        pieces.append(Piece(_CRANK, *arm, Region.METAL))
        pieces.append(Piece(_CRANK, *_ball((0.05, 0.045, 0.015), spacing, pedal), Region.TYRE))
    return pieces


def _tyre(spacing: float) -> tuple[Array, Array]:
    """Points and normals (N, 3) of a tyre about the y axis; spokes are too thin to be seen."""
    count, sides = int(np.ceil(2 * np.pi * WHEEL_RADIUS / spacing)), 5
    around = 2 * np.pi * np.arange(count) / count
    across = 2 * np.pi * np.arange(sides) / sides
    a, b = (grid.ravel() for grid in np.meshgrid(around, across, indexing="ij"))
    ray = np.stack([np.cos(a), 0 * a, np.sin(a)], axis=-1)
    normals = np.cos(b)[:, None] * ray + np.sin(b)[:, None] * np.array([0.0, 1.0, 0.0])
    return (WHEEL_RADIUS - _TYRE) * ray + _TYRE * normals, normals
