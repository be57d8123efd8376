"""Trees: trunk, boughs and a crown of leaf clumps, or tiers of drooping branches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.conifers import conifer
from recast.synthetic.scenery.foliage import GREENS, cores, directions, sprays
from recast.synthetic.scenery.primitives import tube
from recast.synthetic.surface import Surface, concatenate

Array = NDArray[np.float64]

TREE_STYLES = ("round", "conifer", "tall")

BARKS = np.array([(0.11, 0.085, 0.06), (0.15, 0.13, 0.11), (0.09, 0.07, 0.055)])
SPRAYS = 1080
"""In a broad-leaved tree of full detail; two triangles each."""


def tree(
    rng: np.random.Generator, height: float, style: str = "round", detail: float = 1.0
) -> Surface:
    """A tree whose trunk stands at the origin, its crown within 0.45 * height of it.

    Args:
        rng: chooses the shape and the greens.
        height: metres, 1.5 to 30.
        style: "round" (broad-leaved), "conifer" or "tall" (poplar).
        detail: share of the triangles to spend, 0.2 to 1.

    Raises:
        InputError: for impossible sizes and unknown styles.
    """
    require_size("tree", "height", height, 1.5, 30.0)
    require_size("tree", "detail", detail, 0.2, 1.0)
    require_known("tree", "style", style, TREE_STYLES)
    if style == "conifer":
        return conifer(rng, height, detail)
    return _broad_leaved(rng, height, style == "tall", detail)


def _broad_leaved(rng: np.random.Generator, height: float, slim: bool, detail: float) -> Surface:
    green = GREENS[rng.integers(len(GREENS))] * rng.uniform(0.85, 1.2)
    bark = BARKS[rng.integers(len(BARKS))] * rng.uniform(0.8, 1.2)
    half = height * (rng.uniform(0.11, 0.15) if slim else rng.uniform(0.29, 0.39))
    low = height * (rng.uniform(0.08, 0.16) if slim else rng.uniform(0.15, 0.27))
    centres, radii = _clumps(rng, height, half, low, slim)
    share = np.prod(radii, axis=1) ** (2 / 3)
    counts = np.maximum(8, np.round(SPRAYS * detail * share / share.sum())).astype(int)
    skins = []
    middle = np.array([0.0, 0.0, 0.5 * (low + height)])
    size = 1.5 * np.sqrt(share.sum() * 4 * np.pi * 0.42 / counts.sum())
    for centre, radius, count in zip(centres, radii, counts, strict=True):
        out = directions(rng, count)
        points = centre + out * radius * rng.uniform(0.74, 1.08, (count, 1))
        from_middle = points - middle
        # Sprays that lie inside the crown are never seen.
        depth = np.linalg.norm((points - centres[:, None]) / radii[:, None], axis=2).min(axis=0)
        seen = depth > 0.66
        normal = out + 0.8 * from_middle / np.linalg.norm(from_middle, axis=1, keepdims=True)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        light = 0.78 + 0.34 * (points[:, 2:] - low) / (height - low)
        skins.append(sprays(rng, points[seen], normal[seen], size, (green * light)[seen]))
    body = cores(rng, centres, 0.7 * radii, green, 1 if detail > 0.5 else 0)
    return concatenate([_trunk(rng, height, low, centres, bark, slim), body, *skins])


def _clumps(
    rng: np.random.Generator, height: float, half: float, low: float, slim: bool
) -> tuple[Array, Array]:
    """Middles (N, 3) and half axes (N, 3) of the leaf clumps that make up a crown."""
    tall = height - low
    if slim:
        count = 9
        share = (np.arange(count) + 0.5) / count
        width = half * np.sqrt(np.clip(1 - (1.7 * share - 0.75) ** 2, 0.12, 1))
        angle = 2.4 * np.arange(count) + rng.uniform(0, 6.3)
        offset = 0.22 * width
        centres = np.column_stack(
            [offset * np.cos(angle), offset * np.sin(angle), low + tall * (0.08 + 0.86 * share)]
        )
        across = width * rng.uniform(0.75, 0.95, count)
        centres[:, 2] = np.minimum(centres[:, 2], height - 0.15 * tall)
        return centres, np.column_stack([across, across, np.full(count, 0.16 * tall)])
    count = int(rng.integers(8, 12))
    out = directions(rng, count)
    out[:, 2] = np.maximum(out[:, 2], -0.8)
    across = rng.uniform(0.40, 0.54, count)
    flat = across * rng.uniform(0.72, 0.95, count)
    axes = np.array([half, half, 0.5 * tall])
    centres = np.array([0, 0, low + 0.5 * tall]) + out * axes * (1.0 - 0.95 * across)[:, None]
    radii = np.column_stack([across * half, across * half, flat * 0.5 * tall])
    heart = np.array([[0, 0, low + 0.55 * tall]])
    return np.concatenate([centres, heart]), np.concatenate([radii, [axes * 0.55]])


def _trunk(
    rng: np.random.Generator, height: float, low: float, centres: Array, bark: Array, slim: bool
) -> Surface:
    """A trunk that leans a little, and boughs to the lower clumps."""
    foot = height * rng.uniform(0.020, 0.028)
    lean = rng.normal(0, 0.012, 2) * height
    fork = low + (0.55 if slim else 0.25) * (height - low)
    z = np.array([-0.2, 0.03 * height, 0.5 * fork, fork])
    bend = np.column_stack([np.outer([0, 0, 0.6, 1.0], lean), z])
    parts = [tube(bend, foot * np.array([1.5, 1.05, 0.85, 0.6]), 8, bark, "bark")]
    if not slim:
        order = np.argsort(centres[:, 2], kind="stable")[:5]
        start = bend[2] + 0.6 * (bend[3] - bend[2])
        for target in centres[order]:
            knee = 0.5 * (start + target) + [0, 0, -0.02 * height]
            parts.append(
                tube([start, knee, target], foot * np.array([0.5, 0.36, 0.2]), 5, bark, "bark")
            )
    return concatenate(parts)
