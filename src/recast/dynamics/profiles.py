"""Smooth speed and curvature profiles of a sequence of poses, by regularised least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se2

JerkMatrix = Literal["correct", "reference"]

_WEIGHTS_DT = 0.1
"""Seconds between poses for which nuPlan's weights are meant."""


@dataclass(frozen=True)
class Profile:
    """What a pose sequence of M + 1 poses asks of the vehicle.

    Attributes:
        velocity: (..., M) m/s.
        acceleration: (..., M - 1) m/s^2.
        curvature: (..., M) 1/m.
        curvature_rate: (..., M - 1) 1/(m s).
    """

    velocity: Array
    acceleration: Array
    curvature: Array
    curvature_rate: Array


@dataclass(frozen=True)
class ProfileWeights:
    """Regularisation of the fit, as it weighs on poses 0.1 s apart.

    Attributes:
        jerk: weight of squared acceleration differences.
        curvature_rate: weight of squared curvature rates. Other steps scale it with their square,
            so that the same motion is smoothed alike whatever the step; the other two need no such
            scaling.
        initial_curvature: weight of the squared first curvature.
        jerk_matrix: "correct" differences the accelerations, as nuPlan does; "reference" is the
            matrix of NAVSIM and tuplan_garage, which by a slip penalises the accelerations
            themselves. It exists to reproduce their numbers.
    """

    jerk: float = 1e-4
    curvature_rate: float = 1e-2
    initial_curvature: float = 1e-10
    jerk_matrix: JerkMatrix = "correct"


def fit_profile(
    poses: ArrayLike, dt: float = 0.1, weights: ProfileWeights | None = None
) -> Profile:
    """Fit speed and curvature to poses (..., M + 1, 3) that lie `dt` seconds apart, M >= 2.

    Speed minimises |A z - displacement|^2 + jerk |R z|^2 over z = (v_0, a_0, ..., a_{M-2}), where A
    integrates the accelerations and moves along the given headings; curvature likewise over
    (k_0, its rates), from the heading changes and the fitted speed. Both are solved as linear
    systems: pseudo-inverses are unreliable here on standing and constant-speed inputs.

    Source: nuPlan's get_velocity_curvature_profiles_with_derivatives_from_poses.

    Raises:
        ValueError: fewer than three poses.
    """
    weights = weights or ProfileWeights()
    poses = np.asarray(poses, np.float64)
    if poses.ndim < 2 or poses.shape[-2] < 3 or poses.shape[-1] != 3:
        raise ValueError(f"fit_profile: poses (..., M + 1 >= 3, 3) expected, got {poses.shape}")
    count = poses.shape[-2] - 1
    heading = poses[..., :-1, 2]
    displacement = np.diff(poses[..., :2], axis=-2)
    # Rows of A are (cos, sin) times one row of `integrate`: its normal matrix does not depend on
    # the headings, and the data enter as the displacement along the heading.
    along = displacement[..., 0] * np.cos(heading) + displacement[..., 1] * np.sin(heading)
    integrate = _integration_matrix(count, dt)
    difference = _jerk_matrix(count, weights.jerk_matrix)
    normal = integrate.T @ integrate
    normal[1:, 1:] += weights.jerk * difference.T @ difference
    velocity, acceleration = _integrate(_solve(normal, along @ integrate), dt)

    turn = se2.wrap_angle(np.diff(poses[..., 2], axis=-1))
    design = velocity[..., :, None] * integrate
    penalty = np.full(count, weights.curvature_rate * (dt / _WEIGHTS_DT) ** 2)
    penalty[0] = weights.initial_curvature
    normal = np.swapaxes(design, -1, -2) @ design + np.diag(penalty)
    right = np.einsum("...nk,...n->...k", design, turn)
    curvature, curvature_rate = _integrate(_solve(normal, right), dt)
    return Profile(velocity, acceleration, curvature, curvature_rate)


def _integration_matrix(count: int, dt: float) -> Array:
    """(M, M): distance covered in each step by (initial value, rates), all at forward Euler."""
    matrix = dt * dt * np.tri(count)
    matrix[:, 0] = dt
    return matrix


def _jerk_matrix(count: int, kind: JerkMatrix) -> Array:
    """(M - 2, M - 1): see `ProfileWeights.jerk_matrix`."""
    matrix = -np.eye(count - 2, count - 1)
    if kind == "correct":
        matrix += np.eye(count - 2, count - 1, k=1)
    elif count > 2:
        matrix[-1, -1] = 1.0
    return matrix


def _solve(normal: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], np.float64)


def _integrate(solution: Array, dt: float) -> tuple[Array, Array]:
    """Values (..., M) and rates (..., M - 1) of solutions (initial value, rates)."""
    first, rates = solution[..., :1], solution[..., 1:]
    values = np.empty_like(solution)
    values[..., :1] = first
    values[..., 1:] = first + np.cumsum(rates * dt, axis=-1)
    return values, rates
