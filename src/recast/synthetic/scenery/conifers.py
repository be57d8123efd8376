"""Spruces and firs."""

from __future__ import annotations

import numpy as np

from recast.synthetic.materials import MATERIAL_INDEX
from recast.synthetic.scenery.primitives import lathe
from recast.synthetic.surface import Surface, concatenate

NEEDLES = np.array([(0.042, 0.090, 0.032), (0.058, 0.096, 0.058), (0.066, 0.098, 0.030)])
TIERS = 17
FANS = 15
"""Branches in the lowest tier of full detail, 4 triangles each; fewer further up."""


def conifer(rng: np.random.Generator, height: float, detail: float) -> Surface:
    """A conifer of `height` metres at the origin: tiers of drooping branches round a dark core."""
    green = NEEDLES[rng.integers(len(NEEDLES))] * rng.uniform(0.85, 1.25)
    low = height * rng.uniform(0.06, 0.14)
    half = height * rng.uniform(0.18, 0.27)
    trunk = lathe(
        [(0.022 * height, -0.2), (0.016 * height, 0.1 * height), (0.006 * height, 0.8 * height)],
        7,
        (0.09, 0.065, 0.05),
        "bark",
    )
    core = lathe(
        [(0.0, low + 0.02 * height), (0.45 * half, low + 0.04 * height), (0.0, 0.96 * height)],
        9,
        0.4 * green,
        "foliage",
    )
    tiers = max(6, round(TIERS * detail**0.5))
    parts = [trunk, core]
    for k in range(tiers):
        share = k / (tiers - 1)
        reach = half * (1 - share) ** 0.9 + 0.012 * height
        count = max(5, round(FANS * detail**0.5 * (1 - 0.6 * share)))
        z = low + (0.97 * height - low) * share
        parts.append(_tier(rng, count, z, reach, height, green * (0.8 + 0.35 * share)))
    return concatenate(parts)


def _tier(
    rng: np.random.Generator, count: int, z: float, reach: float, height: float, green: np.ndarray
) -> Surface:
    """One whorl: each branch is a folded kite from the trunk to a hanging tip."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.35, 0.35, count)) / count
    angle += rng.uniform(0, 2 * np.pi)
    length = reach * rng.uniform(0.72, 1.12, count)
    droop = length * rng.uniform(0.22, 0.5, count)
    level = z + rng.normal(0, 0.012 * height, count)
    wide = length * np.pi / count * rng.uniform(0.9, 1.5, count) + 0.006 * height
    radial = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    across = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(count)])
    up = np.array([0, 0, 1.0])

    def point(share: float, side: float, fall: float) -> np.ndarray:
        return (
            radial * (share * length)[:, None]
            + across * (side * wide)[:, None]
            + up * (level - fall * droop)[:, None]
        )

    # Root, ridge, tip, and the two hanging edges beside the ridge.
    corners = np.stack(
        [
            point(0.0, 0, -0.35),
            point(0.6, 0, 0.25),
            point(1.0, 0, 1.0),
            point(0.55, -1, 0.75),
            point(0.62, 1, 0.75),
        ],
        axis=1,
    )
    corners[..., 2] = np.clip(corners[..., 2], 0.05, height)
    kite = np.array([(0, 3, 1), (3, 2, 1), (1, 2, 4), (0, 1, 4)], np.int32)
    faces = (kite + 5 * np.arange(count, dtype=np.int32)[:, None, None]).reshape(-1, 3)
    normal = radial * 0.8 + up * 0.6
    normal = normal[:, None] + np.array([-0.35, -0.35, 0.35, 0.35])[:, None] * across[:, None]
    normal = (normal / np.linalg.norm(normal, axis=2, keepdims=True)).reshape(-1, 3)
    shade = np.repeat(rng.uniform(0.7, 1.25, (count, 1)), 4, axis=0)
    # The new growth at the tips is lighter.
    shade *= np.tile([0.85, 1.2, 1.2, 0.85], count)[:, None]
    return Surface(
        corners.reshape(-1, 3),
        faces,
        np.repeat(normal[:, None], 3, axis=1).astype(np.float32),
        np.clip(green * shade, 0, 1).astype(np.float32),
        np.full(len(faces), MATERIAL_INDEX["foliage"], np.uint8),
    )
