"""Rigid transforms in three dimensions, as 4x4 matrices and wxyz quaternions.

A matrix named `target_from_source` maps homogeneous source coordinates to target coordinates. All
functions take any number of leading batch dimensions and work in float64.
"""

from __future__ import annotations

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
    moved: Array = points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3]
    return moved


def quat_to_matrix(quat: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz, normalised first.

    Raises:
        ValueError: a quaternion has norm zero.
    """
    quat = np.asarray(quat, np.float64)
    norm = np.linalg.norm(quat, axis=-1, keepdims=True)
    if np.any(norm == 0.0):
        raise ValueError("quat_to_matrix: quaternion of norm zero")
    w, x, y, z = np.moveaxis(quat / norm, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_to_quat(rotation: ArrayLike) -> Array:
    """Quaternions (..., 4) wxyz with w >= 0 of rotation matrices (..., 3, 3).

    The largest of the four components is computed by a square root, the others divided by it, so
    that no angle loses precision (Shepperd 1978).
    """
    r = np.asarray(rotation, np.float64)
    m00, m11, m22 = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    squares = np.stack(
        [1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22], -1
    )
    wx, wy, wz = (
        r[..., 2, 1] - r[..., 1, 2],
        r[..., 0, 2] - r[..., 2, 0],
        r[..., 1, 0] - r[..., 0, 1],
    )
    xy, xz, yz = (
        r[..., 0, 1] + r[..., 1, 0],
        r[..., 0, 2] + r[..., 2, 0],
        r[..., 1, 2] + r[..., 2, 1],
    )
    candidates = np.stack(
        [
            np.stack([squares[..., 0], wx, wy, wz], -1),
            np.stack([wx, squares[..., 1], xy, xz], -1),
            np.stack([wy, xy, squares[..., 2], yz], -1),
            np.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    quat = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return np.where(quat[..., :1] < 0, -quat, quat)


def rotation_z(angle: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) about z by angles (...) in radians, counter-clockwise."""
    angle = np.asarray(angle, np.float64)
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(angle)
    rotation[..., 1, 0] = np.sin(angle)
    rotation[..., 0, 1] = -rotation[..., 1, 0]
    rotation[..., 2, 2] = 1.0
    return rotation


def yaw(matrix: ArrayLike) -> Array:
    """Heading in radians of the x axis projected to the xy plane, of (..., 3 or 4, 3 or 4)."""
    matrix = np.asarray(matrix, np.float64)
    heading: Array = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
    return heading


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
    unit: Array = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return unit


def exp(twist: ArrayLike) -> Array:
    """Transforms (..., 4, 4) of twists (..., 6) = (translation part in metres, rotation vector).

    The exponential map of SE(3): the translation part is multiplied by the left Jacobian of SO(3).
    """
    twist = np.asarray(twist, np.float64)
    rho, phi = twist[..., :3], twist[..., 3:]
    rotation, left_jacobian, _ = _so3_series(phi)
    return from_rotation_translation(rotation, (left_jacobian @ rho[..., None])[..., 0])


def log(matrix: ArrayLike) -> Array:
    """Twists (..., 6) of transforms (..., 4, 4); inverse of `exp` for rotation angles below pi."""
    matrix = np.asarray(matrix, np.float64)
    quat = matrix_to_quat(matrix[..., :3, :3])
    vector_norm = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(vector_norm, quat[..., :1])
    # angle / sin(angle / 2) tends to 2 for small angles
    scale = np.where(vector_norm > 1e-12, angle / np.maximum(vector_norm, 1e-300), 2.0)
    phi = quat[..., 1:] * scale
    _, _, inverse_jacobian = _so3_series(phi)
    rho = (inverse_jacobian @ matrix[..., :3, 3:4])[..., 0]
    return np.concatenate([rho, phi], axis=-1)


def _so3_series(phi: Array) -> tuple[Array, Array, Array]:
    """Rotation, left Jacobian and its inverse for rotation vectors (..., 3)."""
    theta2 = np.sum(phi * phi, axis=-1)[..., None, None]
    theta = np.sqrt(theta2)
    small = theta < 1e-4
    safe = np.where(small, 1.0, theta)
    half = safe / 2  # 1 - cos(theta) would lose half the digits of a small angle
    a = np.where(small, 1 - theta2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - theta2 / 24, 0.5 * (np.sin(half) / half) ** 2)
    c = np.where(small, 1 / 6 - theta2 / 120, (safe - np.sin(safe)) / safe**3)
    d = np.where(small, 1 / 12 + theta2 / 720, (1 - half / np.tan(half)) / safe**2)
    skew = np.zeros((*phi.shape[:-1], 3, 3))
    skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0] = np.moveaxis(phi, -1, 0)
    skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1] = np.moveaxis(-phi, -1, 0)
    eye = np.eye(3)
    skew2 = skew @ skew
    return eye + a * skew + b * skew2, eye + b * skew + c * skew2, eye - 0.5 * skew + d * skew2


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
    quats = matrix_to_quat(poses[:, :3, :3])
    rotation = quat_to_matrix(slerp(quats[left], quats[right], fraction))
    weight = fraction[..., None]
    translation = (1 - weight) * poses[left, :3, 3] + weight * poses[right, :3, 3]
    return from_rotation_translation(rotation, translation)
