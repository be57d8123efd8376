"""A body on a user's skeleton (SMPL, SMPL-H, SMPL-X) as a surface with a gait.

The poses of the user's files belong to moments of the log. A gait belongs to metres of the way, so
that the body can walk another way. Each pose counts twice: as it is, and mirrored half a cycle
later. So one step is enough.

Frames: rest frame: x left, y up, z ahead; box frame: x ahead, y left, z up; walk frame: as the box
frame, but about the body's mean place and heading. Metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from recast.actors.people.body import PHASES, STRIDE, BodySurface, Region
from recast.arrays import Array, Int64Array
from recast.geometry import se2, se3
from recast.logs import Track
from recast.reconstruction import read_training_config
from recast.reconstruction.bodies import read_bodies
from recast.scene import StreetScene
from recast.scene.actor import SceneActor
from recast.scene.deformation import Skinning, joint_poses

_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
_OTHER = (0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20)
_SHARED = len(_PARENTS)  # joints that the three models have in common
_REGIONS = {Region.TROUSERS: (0, 1, 2, 4, 5), Region.SHOES: (7, 8, 10, 11)}
_REGIONS[Region.TOP] = (3, 6, 9, 13, 14, 16, 17, 18, 19)  # all others are skin
_HEAD, _HIPS, _KNEES = 15, (1, 2), (4, 5)
_BOX_FROM_REST = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
_NEIGHBOURS, _NORMALS_FROM = 6, 12
_ON_BONE = np.linspace(0, 1, 9)[:, None, None]  # shares of a bone at which it is sampled
_MIRROR = np.array([1.0, -1.0, 1.0])  # of places in the walk frame

_ORDER = 3  # harmonics of a cycle
# Ridge in poses: of the mean, of what is not alike on both sides, of the harmonics.
_RIDGE = np.array([1e-6, 0.5, *2 * [0.01 * k**4 for k in range(1, _ORDER + 1)]])
_REACH, _NATURAL = 0.6, 0.15  # logarithm of the cycle: largest change, deviation between people
_BLUR = 0.01  # metres: deviation of joints that poses always have
_STANDS_M, _STILL_M = 0.25, 0.03  # less way, or less motion of the joints, is standing
_GAP = 0.12  # largest part of a cycle without a pose, mirrored poses included
_EXPLAINED = 0.5  # least share of the joints' variance that a gait must explain
_MOST_POSES = 1000


@dataclass(frozen=True)
class SkeletonBody:
    """A body on a skeleton that walks.

    Attributes:
        surface: one patch a vertex, box frame; one motion if the person stands.
        height: metres, at rest.
        cycle: metres of way in two steps.
        phase: share of a cycle that has passed where the way begins.
        explained: share of the joints' variance that the gait explains; 1 if the person stands.
    """

    surface: BodySurface
    height: float
    cycle: float
    phase: float
    explained: float


def rest_vertices(street: StreetScene, track_id: str) -> Array:
    """The vertices (N, 3) that an actor's Gaussians began as, rest frame, metres.

    Training moves the Gaussians, by 3 cm and more. So the user's files are read again.

    Args:
        street: scene with an actor of `Skinning`.

    Raises:
        ValueError: the street is not from a folder, its configuration names no files, or they are
            not as they were; InputError: see `read_bodies`.
    """
    if street.origin is None:
        raise ValueError("the street was not read from a folder")
    config = read_training_config(street.origin)
    tracks = {
        name: Track(name, "pedestrian", actor.size, actor.trajectory)
        for name, actor in street.actors.items()
    }
    body, trained = read_bodies(config, tracks).get(track_id), street.actors[track_id].deformation
    if body is None:
        raise ValueError("the configuration of the street names no files of it")
    same = isinstance(trained, Skinning) and all(
        np.array_equal(np.asarray(getattr(trained, name)), np.asarray(getattr(body.skinning, name)))
        for name in ("weights", "joints", "parents")
    )
    if not same:
        raise ValueError("its files have changed since the street was trained")
    return body.vertices


def skeleton_body(actor: SceneActor, rest: Array, way: Array) -> SkeletonBody:
    """Make a surface and a gait of an actor's skin, joints and poses.

    Args:
        actor: person of a street, with `Skinning`.
        rest: (N, 3) vertices, see `rest_vertices`.
        way: (K, 2) the person's way, metres, see `Gait`.

    Raises:
        ValueError: it has no skeleton of SMPL's joints, its poses show less than one step, or they
            do not repeat with the way.
    """
    skinning = actor.deformation
    if not isinstance(skinning, Skinning) or tuple(skinning.parents[:_SHARED]) != _PARENTS:
        raise ValueError("the first 22 joints are not those of SMPL")
    height = float(np.ptp(rest[:, 1]))
    count = len(skinning.timestamps_us)
    used = np.unique(np.linspace(0, count - 1, min(count, _MOST_POSES)).astype(int))
    first, last = actor.trajectory.timestamps_us[[0, -1]]
    stood = actor.trajectory.at(np.clip(skinning.timestamps_us[used], first, last))
    line = se2.Polyline.from_points(way)
    gone = np.array([line.gone(pose) for pose in se2.from_se3(stood)])
    walks, weights = bool(np.ptp(gone) > _STANDS_M), np.ones(len(gone))
    if walks:  # metres count, not moments: somebody may wait on the way
        steps = np.linalg.norm(np.gradient(stood[:, :2, 3], axis=0), axis=1)
        weights = steps / steps.mean()
    poses = _Poses.of(skinning, used, weights)
    middle = np.average(poses.joints, axis=0, weights=weights)
    spread = np.average((poses.joints - middle) ** 2, axis=0, weights=weights).sum()
    if not walks or spread < _SHARED * _STILL_M**2:
        moved = poses.moved(poses.means[None], np.zeros((1, 3)))
        return SkeletonBody(_surface(rest, skinning, moved), height, STRIDE * height, 0.0, 1.0)

    cycle, left_over = _timed(gone, weights, poses, STRIDE * height)
    explained = float(1 - left_over / spread)
    phases = gone / cycle
    gap = _gap(phases[weights > 0])
    if gap > _GAP:
        raise ValueError(f"the poses show {max(1 - 2 * gap, 0):.0%} of a step, one is needed")
    if explained < _EXPLAINED:
        raise ValueError(f"the poses do not repeat with the way ({explained:.0%} of them do)")
    turns, places = poses.at(phases, weights, np.arange(PHASES) / PHASES)
    # Patches bend about the pose of the first phase: that of the straightest legs bends them least.
    bent = turns[:, _HIPS + _KNEES] @ np.array([1.0, 0, 0, 0])
    start = int(np.abs(bent).sum(axis=1).argmax())
    turns, places = (np.roll(values, -start, axis=0) for values in (turns, places))
    surface = _surface(rest, skinning, poses.moved(turns, places))
    return SkeletonBody(surface, height, cycle, -start / PHASES % 1.0, explained)


@dataclass(frozen=True)
class _Poses:
    """T poses of a skeleton in the walk frame.

    Attributes:
        turns: (T, J, 4) quaternions wxyz in the parents' frames; of the first joint in a rest frame
            that looks ahead.
        joints: (T, 22, 3) places of the shared joints.
        means: (J, 4) weighted means of the turns.
        box_from_walk: (4, 4).
    """

    skinning: Skinning
    turns: Array
    joints: Array
    means: Array
    box_from_walk: Array

    @classmethod
    def of(cls, skinning: Skinning, used: Int64Array, weights: Array) -> _Poses:
        """Some poses of a skin, with weights (T,)."""
        turns = se3.quat_to_matrix(skinning.rotations[used])
        shifts = skinning.translations[used]
        ahead = np.average(turns[:, 0, :2, 2], axis=0, weights=weights)
        turned = se3.rotation_z(np.arctan2(ahead[1], ahead[0]))
        middle = np.average(skinning.joints[0] + shifts, axis=0, weights=weights)
        box_from_walk = se3.from_rotation_translation(turned, middle)
        chains = [joint_poses(one, skinning.joints, skinning.parents) for one in turns]
        joints = np.stack(chains)[:, :_SHARED, :3, 3] + shifts[:, None]
        joints = se3.apply(se3.inverse(box_from_walk), joints)
        turns[:, 0] = (turned @ _BOX_FROM_REST).T @ turns[:, 0]
        quats = se3.matrix_to_quat(turns)
        return cls(skinning, quats, joints, _mean_turns(quats, weights), box_from_walk)

    def at(self, phases: Array, weights: Array, wanted: Array) -> tuple[Array, Array]:
        """Turns (P, J, 4) and places (P, 3) at some phases of the gait; hands keep their mean."""
        own, across = self.turns[:, :_SHARED], self.turns[:, _OTHER] * [1, 1, -1, -1]
        both = np.concatenate([own, across])
        middle = se3.quat_to_matrix(_mean_turns(both, np.tile(weights, 2)))
        apart = middle.swapaxes(1, 2) @ se3.quat_to_matrix(both)
        values = Rotation.from_matrix(apart).as_rotvec()
        places = np.concatenate([self.joints[:, :1], self.joints[:, :1] * _MIRROR])
        values = np.concatenate([values, places], axis=1)
        coefficients, _ = _regressed(phases, weights, *np.split(values, 2))
        found = (_basis(wanted, 1.0) @ coefficients).reshape(len(wanted), -1, 3)
        turns = np.repeat(self.means[None], len(wanted), axis=0)
        swings = Rotation.from_rotvec(found[:, :-1]).as_matrix()
        turns[:, :_SHARED] = se3.matrix_to_quat(middle @ swings)
        return turns, found[:, -1]

    def moved(self, turns: Array, places: Array) -> Array:
        """Motions (P, J, 4, 4) from the rest frame to the box frame."""
        rotations, shape = se3.quat_to_matrix(turns), self.skinning
        rotations[:, 0] = _BOX_FROM_REST @ rotations[:, 0]
        poses = np.stack([joint_poses(one, shape.joints, shape.parents) for one in rotations])
        poses[..., :3, 3] += (places - shape.joints[0])[:, None]
        back = np.tile(np.eye(4), (len(shape.joints), 1, 1))
        back[:, :3, 3] = -shape.joints
        return np.asarray(self.box_from_walk @ poses @ back)


def _mean_turns(quats: Array, weights: Array) -> Array:
    """Weighted mean (J, 4) of rotations (T, J, 4)."""
    each = (Rotation.from_quat(one, scalar_first=True) for one in quats.swapaxes(0, 1))
    return np.stack([one.mean(weights).as_quat(scalar_first=True) for one in each])


def _basis(phases: Array, side: float) -> Array:
    """(T, 2 + 2 `_ORDER`): mean, side, harmonics."""
    turns = 2 * np.pi * np.outer(phases, np.arange(1, _ORDER + 1))
    ones = np.ones((len(phases), 1))
    return np.concatenate([ones, side * ones, np.cos(turns), np.sin(turns)], axis=1)


def _regressed(
    phases: Array, weights: Array, values: Array, mirrored: Array
) -> tuple[Array, float]:
    """Harmonic ridge regression of values (T, ...) and, half a cycle later, of mirrored ones.

    Returns:
        Coefficients (2 + 2 `_ORDER`, C), and the weighted mean square of what they leave over.
    """
    basis = np.concatenate([_basis(phases, 1.0), _basis(phases + 0.5, -1.0)])
    both = np.concatenate([values, mirrored]).reshape(len(basis), -1)
    heavy = np.tile(weights, 2)[:, None]
    normal = basis.T @ (heavy * basis) + np.diag(_RIDGE)
    coefficients = np.linalg.solve(normal, basis.T @ (heavy * both))
    wrong = heavy * (both - basis @ coefficients) ** 2
    total = wrong.sum() + (_RIDGE[1:, None] * coefficients[1:] ** 2).sum()
    return coefficients, float(total / heavy.sum())


def _timed(gone: Array, weights: Array, poses: _Poses, usual: float) -> tuple[float, float]:
    """Cycle in metres at which poses repeat best, and the mean square that it leaves over."""
    across = poses.joints[:, _OTHER] * _MIRROR
    span = float(np.ptp(gone))
    count = int(np.clip(30 * span / usual, 61, 1501))
    best = np.inf, usual, np.inf
    for change in np.linspace(-_REACH, _REACH, count):
        cycle = float(usual * np.exp(change))
        wrong = _regressed(gone / cycle, weights, poses.joints, across)[1]
        doubt = 3 * len(gone) * np.log(wrong / _SHARED + _BLUR**2) + (change / _NATURAL) ** 2
        best = min(best, (doubt, cycle, wrong))
    return best[1], best[2]


def _gap(phases: Array) -> float:
    """Largest part of a cycle without a pose, if each pose counts half a cycle later, too."""
    places = np.sort(phases % 0.5)
    return float(np.diff(places, append=places[0] + 0.5).max())


def _surface(rest: Array, skinning: Skinning, moved: Array) -> BodySurface:
    """The skin (N, 3) in the pose of the first of some motions (P, J, 4, 4) `box_from_rest`."""
    weights = skinning.weights.detach().double().cpu().numpy()
    weights /= weights.sum(axis=1, keepdims=True)
    heaviest = weights.argmax(axis=1)
    tree = cKDTree(rest)
    distances, near = tree.query(rest, k=min(_NORMALS_FROM, len(rest)))
    region = np.full(len(rest), int(Region.SKIN), np.int64)
    for kind, joints in _REGIONS.items():
        region[np.isin(heaviest, joints)] = kind
    region[_hair(rest, heaviest == _HEAD)] = Region.HAIR
    blend = np.einsum("nj,jab->nab", weights, moved[0])
    normals = np.einsum("nab,nb->na", blend[:, :3, :3], _normals(rest, near, skinning))
    return BodySurface(
        np.einsum("nab,nb->na", blend[:, :3, :3], rest) + blend[:, :3, 3],
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        np.maximum(distances[:, 1 : 1 + _NEIGHBOURS].mean(axis=1), 1e-3),
        region,
        weights,
        np.asarray(tree.query(rest * [-1.0, 1.0, 1.0])[1], np.int64),
        moved @ se3.inverse(moved[0]),
    )


def _hair(rest: Array, head: ArrayLike) -> Int64Array:
    """Numbers of the points of a head, chosen by (N,), that are above or behind the face."""
    rows = np.flatnonzero(head)
    if len(rows) == 0:
        return rows
    low, high = rest[rows].min(axis=0), rest[rows].max(axis=0)
    _, up, ahead = (2 * (rest[rows] - low) / np.maximum(high - low, 1e-6) - 1).T
    return rows[(ahead < -0.15) & (up > -0.6) | (up > 0.62)]


def _normals(rest: Array, near: Int64Array, skinning: Skinning) -> Array:
    """Normals (N, 3) of the planes through each point's neighbours (N, K), away from the bones."""
    around = rest[near] - rest[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nka,nkb->nab", around, around))[1][..., 0]
    ends = np.arange(1, len(skinning.joints))
    starts = skinning.parents[ends]
    along = skinning.joints[ends] - skinning.joints[starts]
    bones = (skinning.joints[starts] + _ON_BONE * along).reshape(-1, 3)
    outward = rest - bones[cKDTree(bones).query(rest)[1]]
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    sure = np.einsum("na,na->n", normals, outward)
    # Neighbours outvote a point whose bone lies beside it.
    votes = np.einsum("nka,na,nk->n", normals[near], normals, sure[near])
    return np.where(votes < 0, -1.0, 1.0)[:, None] * normals
