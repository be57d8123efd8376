"""SE(3): group axioms, quaternions, exponential map, interpolation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from recast.geometry import se3

from .strategies import points3, quaternions, rotation_vectors, transforms


def close(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@given(transforms, transforms, transforms)
def test_group_axioms(a, b, c):
    close((a @ b) @ c, a @ (b @ c))
    close(a @ se3.inverse(a), np.eye(4))
    close(se3.inverse(a) @ a, np.eye(4))
    close(se3.inverse(a @ b), se3.inverse(b) @ se3.inverse(a))


@given(transforms, transforms, points3)
def test_apply_is_the_action_of_the_group(a, b, point):
    close(se3.apply(a @ b, point[None]), se3.apply(a, se3.apply(b, point[None])))
    homogeneous = a @ np.append(point, 1.0)
    close(se3.apply(a, point[None])[0], homogeneous[:3])


@given(transforms, st.floats(-4e-4, 4e-4))
def test_the_nearest_rotation_of_a_printed_one(pose, slip):
    printed = pose[:3, :3] + slip * np.outer([1.0, -0.5, 0.3], [0.2, 1.0, -0.7])
    (found, mirrored), off = se3.nearest_rotations([printed, -printed])
    close(found @ found.T, np.eye(3))
    close(off[0], np.abs(found - printed).max())
    # The polar factor is nearest in Frobenius' norm, and the rotation it came from is another one.
    assert np.linalg.norm(found - printed) <= np.linalg.norm(pose[:3, :3] - printed) + 1e-9
    assert off[1] == np.inf
    close(mirrored, -found)


def test_apply_batches():
    rng = np.random.default_rng(0)
    matrices = se3.exp(rng.normal(size=(5, 6)))
    points = rng.normal(size=(5, 7, 3))
    moved = se3.apply(matrices, points)
    for i in range(5):
        close(moved[i], se3.apply(matrices[i], points[i]), 1e-12)


@given(quaternions)
def test_quaternion_round_trip(quat):
    matrix = se3.quat_to_matrix(quat)
    close(matrix @ matrix.T, np.eye(3), 1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    back = se3.matrix_to_quat(matrix)
    assert back[0] >= 0
    close(abs(back @ quat), 1.0, 1e-12)
    close(se3.quat_to_matrix(back), matrix, 1e-12)


@given(quaternions)
def test_quaternions_are_wxyz_as_scipys_are_not(quat):
    close(se3.quat_to_matrix(quat), Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix(), 1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_round_trip(axis):
    """The trace is -1: only the largest component keeps its digits."""
    quat = np.eye(4)[1 + axis]
    close(se3.matrix_to_quat(se3.quat_to_matrix(quat)), quat, 1e-15)


def test_quaternion_of_norm_zero_is_refused():
    with pytest.raises(ValueError, match="zero norm"):
        se3.quat_to_matrix(np.zeros((2, 4)))


@given(rotation_vectors, points3)
def test_exp_and_log_are_inverse(phi, rho):
    rho = rho / 100
    twist = np.concatenate([rho, phi])
    matrix = se3.exp(twist)
    close(matrix[:3, :3], Rotation.from_rotvec(phi).as_matrix(), 1e-12)
    # two rotation vectors near a half turn differ by much for matrices that differ by little
    close(se3.exp(se3.log(matrix)), matrix, 1e-10)
    close(se3.log(matrix), twist, 1e-8)


@pytest.mark.parametrize("size", [1e-6, 1.01e-4, 1e-3, 1e-2])
def test_log_keeps_its_digits_at_small_angles(size):
    twist = np.array([10.0, -20.0, 5.0, size, -size, size / 2])
    close(se3.log(se3.exp(twist)), twist, 1e-12)


@given(transforms)
def test_exp_of_log(matrix):
    close(se3.exp(se3.log(matrix)), matrix, 1e-6)


def test_exp_of_a_screw_follows_the_arc():
    quarter = se3.exp([np.pi / 2, 0, 0, 0, 0, np.pi / 2])  # unit radius, a quarter turn
    close(quarter[:3, 3], [1.0, 1.0, 0.0], 1e-12)


@given(quaternions, quaternions, st.floats(0, 1))
def test_slerp_turns_evenly(a, b, fraction):
    middle = se3.slerp(a, b, fraction)
    close(np.linalg.norm(middle), 1.0, 1e-12)
    close(abs(se3.slerp(a, b, 0.0) @ a), 1.0, 1e-12)
    close(abs(se3.slerp(a, b, 1.0) @ b), 1.0, 1e-12)

    def angle(p, q):
        relative = se3.quat_to_matrix(p).T @ se3.quat_to_matrix(q)
        return np.linalg.norm(se3.log(se3.from_rotation_translation(relative, np.zeros(3)))[3:])

    close(angle(a, middle), fraction * angle(a, b), 1e-7)
    close(angle(middle, b), (1 - fraction) * angle(a, b), 1e-7)


@given(quaternions, st.floats(0, 1))
def test_slerp_between_a_quaternion_and_its_negative_stays(quat, fraction):
    close(abs(se3.slerp(quat, -quat, fraction) @ quat), 1.0, 1e-12)


def test_slerp_a_half_turn_apart_is_finite_and_halfway():
    middle = se3.slerp([1.0, 0, 0, 0], [0.0, 0, 0, 1], 0.5)
    close(se3.quat_to_matrix(middle), se3.rotation_z(np.pi / 2), 1e-12)


@given(transforms, transforms, st.integers(1, 10**7), st.floats(0, 1))
def test_interpolation(first, last, span, fraction):
    times = np.array([10**15, 10**15 + span])
    poses = np.stack([first, last])
    query = 10**15 + round(fraction * span)
    found = se3.interpolate(times, poses, [times[0], query, times[1]])
    close(found[0], first, 1e-9)
    close(found[2], last, 1e-9)
    weight = (query - 10**15) / span
    close(found[1, :3, 3], (1 - weight) * first[:3, 3] + weight * last[:3, 3], 1e-9)
    close(found[1, :3, :3] @ found[1, :3, :3].T, np.eye(3), 1e-12)


def test_interpolation_halfway_is_half_the_turn():
    poses = se3.from_rotation_translation(se3.rotation_z([0.2, 1.0]), [[0.0, 0, 0], [2.0, 4, 6]])
    halfway = se3.interpolate([0, 100], poses, 50)
    assert halfway.shape == (4, 4)
    close(halfway, se3.from_rotation_translation(se3.rotation_z(0.6), [1.0, 2, 3]), 1e-12)


@pytest.mark.parametrize("query", [-1, 101])
def test_interpolation_never_extrapolates(query):
    with pytest.raises(ValueError, match="outside"):
        se3.interpolate([0, 100], np.stack([np.eye(4)] * 2), query)


def test_interpolation_wants_increasing_times_and_a_pose_each():
    poses = np.stack([np.eye(4)] * 2)
    with pytest.raises(ValueError, match="increase"):
        se3.interpolate([5, 5], poses, 5)
    with pytest.raises(ValueError, match="3 timestamps"):
        se3.interpolate([1, 2, 3], poses, 2)
    with pytest.raises(ValueError, match="0 timestamps"):
        se3.interpolate([], np.zeros((0, 4, 4)), [])


def test_a_single_pose_holds_at_its_time_only():
    close(se3.interpolate([7], np.eye(4)[None], [7, 7]), np.stack([np.eye(4)] * 2))
    with pytest.raises(ValueError, match="outside"):
        se3.interpolate([7], np.eye(4)[None], 8)


@given(st.floats(-3.1, 3.1))
def test_yaw_of_a_rotation_about_z(angle):
    close(se3.yaw(se3.rotation_z(angle)), angle, 1e-12)
