"""Constrained ICP of an asset's surface to LiDAR points: isotropic scale, yaw and translation.

The LiDAR is partial, so every LiDAR point looks for its nearest surface point and never the other
way round. Distances are taken along surface normals (point to plane, Chen and Medioni 1992), the
worst 15 % are left out, the rest weighted by Huber's function, and weak priors hold what the
points do not tell: a car seen only from the rear has no length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.actors.hull import Surface
from recast.geometry import se3

Array = NDArray[np.float64]

INLIER_DISTANCE = 0.10  # metres


@dataclass(frozen=True)
class IcpLimits:
    """Bounds and stopping rule.

    Attributes:
        scale: smallest and largest factor.
        scale_deviation: prior deviation of the factor's logarithm from 0, which is the start: the
            length of the box, as labels give it.
        yaw: largest turn either way, radians.
        shift: longest translation, metres.
        trim: share of the worst points left out.
        iterations: at most.
        tolerance: stop when the largest move of a surface point falls below this, metres.
    """

    scale: tuple[float, float] = (0.8, 1.25)
    scale_deviation: float = 0.025
    yaw: float = float(np.radians(15.0))
    shift: float = 0.5
    trim: float = 0.15
    iterations: int = 60
    tolerance: float = 2e-4


@dataclass(frozen=True)
class Fit:
    """How well LiDAR points lie on a surface: distances to the nearest surface point.

    Attributes:
        median, mean: metres, over all points.
        inlier_share: points nearer than 0.10 m.
    """

    median: float
    mean: float
    inlier_share: float


@dataclass(frozen=True)
class IcpResult:
    """asset_aligned = R(yaw) (scale x) + translation.

    Attributes:
        scale, yaw: factor and radians.
        translation: (3,) metres.
        iterations: done.
        converged: whether it stopped by `tolerance` and not by `iterations`.
    """

    scale: float
    yaw: float
    translation: Array
    iterations: int
    converged: bool

    @property
    def matrix(self) -> Array:
        """(4, 4) rigid part, applied after the scale."""
        return se3.from_rotation_translation(se3.rotation_z(self.yaw), self.translation)

    def apply(self, points: Array) -> Array:
        """Points (N, 3) moved."""
        return se3.apply(self.matrix, points * self.scale)


def fit_of(surface_points: Array, lidar: Array) -> Fit:
    """Nearest-neighbour distances from LiDAR points (M, 3) to surface points (N, 3)."""
    distance, _ = cKDTree(surface_points).query(lidar)
    return Fit(
        median=float(np.median(distance)),
        mean=float(np.mean(distance)),
        inlier_share=float(np.mean(distance < INLIER_DISTANCE)),
    )


# Prior deviations of yaw (radians) and translation (metres); how many independent measurements a
# cloud is worth; and to how many metres each is good, before what the asset is off by is added. A
# generated vehicle is off by centimetres to a decimetre over whole panels: were LiDAR of two sides
# trusted to its own noise, a car that came out too flat would be stretched by a sixth to mend it.
_PRIOR = np.array([0.20, 0.50, 0.50, 0.50])
_EFFECTIVE = 50.0
_NOISE = 0.03


def align(
    surface: Surface, lidar: Array, limits: IcpLimits | None = None, floor: float | None = None
) -> IcpResult:
    """Move an asset's surface onto LiDAR points.

    Args:
        surface: roughly aligned already: metres, actor frame.
        lidar: (M, 3) actor frame.
        limits: bounds and stopping rule.
        floor: height to which the lowest point of the surface is tied; None leaves it free.

    Returns:
        The move, within the limits.
    """
    limits = limits or IcpLimits()
    bottom = float(surface.points[:, 2].min())
    # the nearest surface point of a LiDAR point is sought in the frame of the asset as it came
    tree = cKDTree(surface.points)
    state = np.zeros(5)  # log scale, yaw, x, y, z
    if floor is not None:
        state[4] = floor - bottom
    radius = float(np.linalg.norm(surface.points[:, :2], axis=1).max())
    damping = 1.0
    converged = False
    iteration = 0
    for iteration in range(1, limits.iterations + 1):
        step = _step(surface, tree, lidar, state, limits, floor, bottom)
        proposed = _limited(state + damping * step, limits, floor, bottom)
        change = proposed - state
        if iteration > 20:  # matches that flip back and forth settle under shorter steps
            damping = 0.5
        state = proposed
        moved = np.abs(change[0]) * radius + np.abs(change[1]) * radius
        if moved + float(np.linalg.norm(change[2:])) < limits.tolerance:
            converged = True
            break
    return IcpResult(
        scale=float(np.exp(state[0])),
        yaw=float(state[1]),
        translation=state[2:].copy(),
        iterations=iteration,
        converged=converged,
    )


def _step(
    surface: Surface, tree: cKDTree, lidar: Array, state: Array, limits: IcpLimits,
    floor: float | None, bottom: float,
) -> Array:  # fmt: skip
    """One Gauss-Newton step (5,) with fresh nearest neighbours."""
    scale, rotation = np.exp(state[0]), se3.rotation_z(state[1])
    local = (lidar - state[2:]) @ rotation / scale
    distance, nearest = tree.query(local)
    kept = distance <= np.quantile(distance, 1 - limits.trim)
    points = surface.points[nearest[kept]] * scale @ rotation.T
    normals = surface.normals[nearest[kept]] @ rotation.T
    residual = np.sum(normals * (lidar[kept] - points - state[2:]), axis=1)

    spread = max(1.4826 * float(np.median(np.abs(residual))), 0.01)
    weight = 1.0 / np.maximum(1.0, np.abs(residual) / (1.5 * spread))
    turned = np.stack([-points[:, 1], points[:, 0], np.zeros(len(points))], axis=-1)
    jacobian = np.concatenate(
        [np.sum(normals * points, axis=1)[:, None], np.sum(normals * turned, axis=1)[:, None],
         normals], axis=1
    )  # fmt: skip
    prior = state.copy()
    if floor is not None:
        # the height follows from the scale: dz = -bottom * scale * dlog(scale)
        jacobian[:, 0] -= normals[:, 2] * bottom * scale
        jacobian[:, 4] = 0.0
        prior[4] = 0.0
    worth = min(_EFFECTIVE, len(lidar)) / (len(residual) * (_NOISE + spread) ** 2)
    information = 1 / np.array([limits.scale_deviation, *_PRIOR]) ** 2
    normal = worth * (jacobian * weight[:, None]).T @ jacobian + np.diag(information)
    right = worth * jacobian.T @ (weight * residual) - information * prior
    step: Array = np.linalg.solve(normal, right)
    return step


def _limited(state: Array, limits: IcpLimits, floor: float | None, bottom: float) -> Array:
    """The state inside the limits; the height follows the floor where there is one."""
    state = state.copy()
    state[0] = np.clip(state[0], np.log(limits.scale[0]), np.log(limits.scale[1]))
    state[1] = np.clip(state[1], -limits.yaw, limits.yaw)
    held = 2 if floor is not None else 3
    length = float(np.linalg.norm(state[2 : 2 + held]))
    if length > limits.shift:
        state[2 : 2 + held] *= limits.shift / length
    if floor is not None:
        state[4] = floor - bottom * np.exp(state[0])
    return state
