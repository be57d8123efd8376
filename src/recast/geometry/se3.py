"""Rigid transforms in three dimensions, as 4x4 matrices and wxyz quaternions.

A matrix named `target_from_source` maps homogeneous source coordinates to target coordinates. All
functions take any number of leading batch dimensions and work in float64.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array


def from_rotation_translation(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Build (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3) in metres."""
    rotation = np.asarray(rotation, np.float64)
    translation = np.asarray(translation, np.float64)
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    matrix = np.zeros((*batch, 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def inverse(matrix: ArrayLike) -> Array:
    """Inverse of rigid transforms (..., 4, 4), by transposing the rotation."""
    matrix = np.asarray(matrix, np.float64)
    rotation_t = np.swapaxes(matrix[..., :3, :3], -1, -2)
    return from_rotation_translation(rotation_t, -(rotation_t @ matrix[..., :3, 3:4])[..., 0])


def apply(matrix: ArrayLike, points: ArrayLike) -> Array:
    """Transform points (..., N, 3) by matrices (..., 4, 4)."""
    matrix = np.asarray(matrix, np.float64)
    points = np.asarray(points, np.float64)
    return points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]


def nearest_rotations(matrices: ArrayLike) -> tuple[Array, Array]:
    """Rotations nearest to finite matrices (..., 3, 3) that are not quite orthogonal.

    Returns:
        rotations (..., 3, 3), and how far each is off in its worst entry (...): infinitely far
        where the matrix mirrors.
    """
    matrices = np.asarray(matrices, np.float64)
    left, _, right = np.linalg.svd(matrices)
    rotations = left @ right
    off = np.abs(rotations - matrices).max(axis=(-2, -1), initial=0.0)
    return rotations, np.where(np.linalg.det(rotations) > 0, off, np.inf)


def quat_to_matrix(quat: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz, normalised first. Raises
    ValueError: a quaternion has norm zero."""
    rotation = _transform().Rotation.from_quat(np.asarray(quat, np.float64), scalar_first=True)
    return np.asarray(rotation.as_matrix())


def matrix_to_quat(rotation: ArrayLike) -> Array:
    """Quaternions (..., 4) wxyz with w >= 0 of rotation matrices (..., 3, 3)."""
    matrix = np.asarray(rotation, np.float64)
    rotations = _transform().Rotation.from_matrix(matrix, assume_valid=True)
    return np.asarray(rotations.as_quat(canonical=True, scalar_first=True))


def rotation_z(angle: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) about z by angles (...) in radians, counter-clockwise."""
    angle = np.asarray(angle, np.float64)
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(angle)
    rotation[..., 1, 0] = np.sin(angle)
    rotation[..., 0, 1] = -rotation[..., 1, 0]
    rotation[..., 2, 2] = 1.0
    return rotation


def direction(azimuth: ArrayLike, elevation: ArrayLike) -> Array:
    """Unit vectors (..., 3) by azimuth from x towards y and elevation above the xy plane.

    Args:
        azimuth, elevation: radians, of shapes that broadcast.
    """
    level = np.cos(elevation)
    parts = level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def yaw(matrix: ArrayLike) -> Array:
    """Heading in radians of the x axis projected to the xy plane, of (..., 3 or 4, 3 or 4)."""
    matrix = np.asarray(matrix, np.float64)
    return np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])


def slerp(quat0: ArrayLike, quat1: ArrayLike, fraction: ArrayLike) -> Array:
    """Spherical interpolation between unit quaternions (..., 4) wxyz along the shorter arc.

    Half a turn apart, either arc is the shorter one; the one taken then depends on the signs given.

    Args:
        fraction: (...), 0 gives `quat0`, 1 gives `quat1`.
    """
    quat0 = np.asarray(quat0, np.float64)
    quat1 = np.asarray(quat1, np.float64)
    fraction = np.asarray(fraction, np.float64)[..., None]
    dot = np.sum(quat0 * quat1, axis=-1, keepdims=True)
    quat1 = np.where(dot < 0, -quat1, quat1)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = angle < 1e-6  # sin(angle) underflows: the chord is exact to 1e-12 there
    sine = np.where(near, 1.0, np.sin(angle))
    weight0 = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / sine)
    weight1 = np.where(near, fraction, np.sin(fraction * angle) / sine)
    quat = weight0 * quat0 + weight1 * quat1
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def exp(twist: ArrayLike) -> Array:
    """Transforms (..., 4, 4) of twists (..., 6) = (translation part in metres, rotation vector).

    The exponential map of SE(3): the translation part is multiplied by the left Jacobian of SO(3).
    """
    coordinates = np.roll(np.asarray(twist, np.float64), 3, axis=-1)
    return np.asarray(_transform().RigidTransform.from_exp_coords(coordinates).as_matrix())


def log(matrix: ArrayLike) -> Array:
    """Twists (..., 6) of transforms (..., 4, 4); inverse of `exp` for rotation angles below pi."""
    poses = _transform().RigidTransform.from_matrix(np.asarray(matrix, np.float64))
    return np.roll(poses.as_exp_coords(), 3, axis=-1)


def _transform() -> ModuleType:
    from scipy.spatial import transform  # half a second, which most commands need not wait

    return transform


def interpolate(timestamps_us: ArrayLike, poses: ArrayLike, query_us: ArrayLike) -> Array:
    """Poses at query times: translation linearly, rotation by slerp.

    Args:
        timestamps_us: (T,) int64, strictly increasing, microseconds.
        poses: (T, 4, 4).
        query_us: (...) microseconds, within [first, last]; never extrapolated.

    Returns:
        (..., 4, 4).

    Raises:
        ValueError: a query lies outside the recorded interval, timestamps do not increase, or there
            is not one pose for each.
    """
    times = np.asarray(timestamps_us, np.int64)
    poses = np.asarray(poses, np.float64)
    query = np.asarray(query_us, np.int64)
    if len(times) == 0 or poses.shape != (len(times), 4, 4):
        raise ValueError(f"interpolate: {len(times)} timestamps_us for poses {poses.shape}")
    if np.any(np.diff(times) <= 0):
        raise ValueError("interpolate: timestamps_us must increase strictly")
    if query.size and (query.min() < times[0] or query.max() > times[-1]):
        raise ValueError(
            f"interpolate: query [{query.min()}, {query.max()}] us lies outside the recorded "
            f"interval [{times[0]}, {times[-1]}] us"
        )
    if len(times) == 1:
        return np.broadcast_to(poses[0], (*query.shape, 4, 4)).copy()
    right = np.clip(np.searchsorted(times, query, side="right"), 1, len(times) - 1)
    left = right - 1
    fraction = (query - times[left]) / (times[right] - times[left])
    if query.size:  # no others are asked for, and a log has thousands
        low, high = int(left.min()), int(right.max())
        poses, left, right = poses[low : high + 1], left - low, right - low
    quats = matrix_to_quat(poses[:, :3, :3])
    rotation = quat_to_matrix(slerp(quats[left], quats[right], fraction))
    weight = fraction[..., None]
    translation = (1 - weight) * poses[left, :3, 3] + weight * poses[right, :3, 3]
    return from_rotation_translation(rotation, translation)
