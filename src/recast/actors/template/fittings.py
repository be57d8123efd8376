"""Wheels and mirrors of the left side; the right side mirrors them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from recast.actors.template.body import Body
from recast.actors.template.materials import Material

Array = NDArray[np.float64]
Labels = NDArray[np.int64]


def wheel(body: Body, axle_x: float, spacing: float) -> tuple[Array, Array, Labels]:
    """Points (N, 3), outward normals (N, 3) and materials (N,) of the left wheel on one axle.

    A lathed tyre and rim; the gaps between the ten spokes lie 5 cm behind them.

    Args:
        spacing: metres between points.
    """
    r, w = body.wheel_radius, body.wheel_width
    profile = np.array(
        [(0.0, -0.03), (0.14 * r, -0.03), (0.18 * r, -0.045), (0.58 * r, -0.025),
         (0.64 * r, -0.005), (0.69 * r, -0.018), (0.84 * r, 0.0), (0.95 * r, -0.018),
         (r, -0.05), (r, -w + 0.05),
         (0.95 * r, -w + 0.018), (0.8 * r, -w), (0.5 * r, -w)]
    )  # fmt: skip
    radii, depths, slopes = [], [], []
    for (r0, d0), (r1, d1) in pairwise(profile):
        n = max(1, int(np.ceil(np.hypot(r1 - r0, d1 - d0) / spacing)))
        t = (np.arange(n) + 0.5) / n
        radii.append(r0 + t * (r1 - r0))
        depths.append(d0 + t * (d1 - d0))
        slopes.append(np.tile([(d0 - d1), (r1 - r0)], (n, 1)) / np.hypot(r1 - r0, d1 - d0))
    rings = np.concatenate(radii), np.concatenate(depths), np.concatenate(slopes)
    per_ring = np.maximum(6, np.ceil(2 * np.pi * rings[0] / spacing)).astype(int)
    ring = np.repeat(np.arange(len(per_ring)), per_ring)
    within = np.arange(len(ring)) - np.repeat(np.cumsum(per_ring) - per_ring, per_ring)
    angle = 2 * np.pi * (within + 0.5 * (ring % 2)) / per_ring[ring]
    radius, depth, slope = rings[0][ring], rings[1][ring], rings[2][ring]

    labels = np.full(len(ring), int(Material.TYRE))
    outer = depth > -0.06
    rim = outer & (radius < 0.67 * r)
    labels[rim] = Material.ALLOY
    fold = np.abs((angle / (2 * np.pi) * 10) % 1 - 0.5)
    gap = rim & (radius > 0.2 * r) & (radius < 0.57 * r) & (fold > 0.17 + 0.02 * r / radius)
    labels[gap] = Material.DARK
    labels[rim & (radius > 0.655 * r)] = Material.DARK
    labels[outer & (radius < 0.05 * r)] = Material.TRIM
    depth = np.where(gap, depth - 0.05, depth)

    cos, sin = np.cos(angle), np.sin(angle)
    centre = np.array([axle_x, body.width / 2 - 0.012, r])
    points = centre + np.stack([radius * cos, depth, radius * sin], axis=-1)
    normals = np.stack([slope[:, 0] * cos, slope[:, 1], slope[:, 0] * sin], axis=-1)
    return points, normals, labels


def mirror(body: Body, spacing: float) -> tuple[Array, Array, Labels]:
    """Points, normals and materials of the left outside mirror, 8 cm beyond the box."""
    p = body.proportions
    scale = np.clip(body.height / 1.5, 1.0, 1.8)
    radii = np.array([0.06, 0.095, 0.065 * scale]) * np.array([1.0, 1.0, scale])
    x = body.x_at(p.cowl_x) - 0.42 * body.height / 1.5
    x = min(x, body.x_at(p.cowl_x + 0.02))
    z = p.cowl_z * body.height + 0.07 * scale
    centre = np.array([x, body.width / 2 - 0.01, z])
    count = int(4 * np.pi * 0.075**2 * scale**2 / spacing**2) + 50
    index = np.arange(count) + 0.5
    up = 1 - 2 * index / count  # Fibonacci sphere
    around = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - up**2)
    unit = np.stack([ring * np.cos(around), ring * np.sin(around), up], axis=-1)
    labels = np.full(count, int(Material.PAINT))
    labels[unit[:, 0] < -0.5] = Material.GLASS
    labels[unit[:, 2] < -0.8] = Material.TRIM
    normals = unit / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return centre + unit * radii, normals, labels
