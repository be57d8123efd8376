"""The vehicle's surface as a dense cloud of small patches with their material properties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.actors.template import decals, fittings
from recast.actors.template.body import Body
from recast.actors.template.lighting import to_linear
from recast.actors.template.materials import GLASS, GLOSS, PAINTED, RIM, SRGB, Material
from recast.actors.template.surface import sample

Array = NDArray[np.float64]
Labels = NDArray[np.int64]
Labeller = Callable[[Array, Array], Labels]

_MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SurfaceCloud:
    """N surface patches; x forward, y left, z up from the ground, metres.

    Attributes:
        points, normals: (N, 3).
        spacing: (N,) edge of the patch.
        albedo: (N, 3) linear reflectance of what is not body paint, weighted by 1 - `paint`.
        gloss: (N,) see `lighting.shade`.
        paint, glass, rim: (N,) share of body paint, of window, of the metal of wheels.
        twin: (N,) index of the patch mirrored at the xz plane.
        on_body: (N,) whether the patch belongs to the body, not to a wheel or mirror.
    """

    points: Array
    normals: Array
    spacing: Array
    albedo: Array
    gloss: Array
    paint: Array
    glass: Array
    rim: Array
    twin: Labels
    on_body: NDArray[np.bool_]

    def painted(self, paint: Array) -> Array:
        """Albedo (N, 3) with the body paint, a linear reflectance (3,), filled in."""
        return self.albedo + self.paint[:, None] * paint


def tangents(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) that span each surface patch with its normal (right-handed)."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def build_cloud(body: Body, spacing: float, rng: np.random.Generator) -> SurfaceCloud:
    """Cover body, wheels and mirrors with patches of edge `spacing`, finer where colours meet.

    The left half is sampled and mirrored, so that every patch has a twin; colours are decided for
    both halves, since number plates are not symmetric.
    """
    low = np.array([-body.length / 2 - 0.01, 0.0, 0.0])
    high = np.array([body.length / 2 + 0.01, body.width / 2 + 0.01, body.height + 0.02])
    points, normals = sample(body.distance, low, high, spacing, rng)
    left = _refined(points, normals, spacing, lambda p, n: decals.label_body(body, p, n))
    right = _appearance(left[0] * _MIRROR, left[1] * _MIRROR, left[2],
                        lambda p, n: decals.label_body(body, p, n))  # fmt: skip
    sides = [(*left, *right)]
    extras = [fittings.wheel(body, axle, spacing) for axle in body.axles]
    extras.append(fittings.mirror(body, spacing))
    for points, normals, labels in extras:
        look = _look(labels)
        sides.append((points, normals, np.full(len(points), spacing), *look, *look))
    body_count = len(left[0])
    joined = [np.concatenate(parts) for parts in zip(*sides, strict=True)]
    count = len(joined[0])
    return SurfaceCloud(
        points=np.concatenate([joined[0], joined[0] * _MIRROR]),
        normals=np.concatenate([joined[1], joined[1] * _MIRROR]),
        spacing=np.concatenate([joined[2], joined[2]]),
        albedo=np.concatenate([joined[3], joined[8]]),
        gloss=np.concatenate([joined[4], joined[9]]),
        paint=np.concatenate([joined[5], joined[10]]),
        glass=np.concatenate([joined[6], joined[11]]),
        rim=np.concatenate([joined[7], joined[12]]),
        twin=np.concatenate([np.arange(count) + count, np.arange(count)]),
        on_body=np.tile(np.arange(count) < body_count, 2),
    )


def _look(labels: Labels) -> tuple[Array, ...]:
    """Albedo, gloss, and the shares of paint, window and rim."""
    paint = PAINTED[labels]
    albedo: Array = to_linear(SRGB)[labels] * (1 - paint)[..., None]
    return albedo, GLOSS[labels], paint, GLASS[labels], RIM[labels]


def _children(points: Array, normals: Array, spacing: Array) -> Array:
    """Centres (4, N, 3) of the quarters of each patch."""
    first, second = tangents(normals)
    step = spacing[:, None] / 4
    return np.stack([points + a * step * first + b * step * second
                     for a in (-1, 1) for b in (-1, 1)])  # fmt: skip


def _appearance(
    points: Array, normals: Array, spacing: Array, labeller: Labeller
) -> tuple[Array, ...]:
    """What `_look` gives, averaged over the quarters of each patch."""
    looks = [_look(labeller(quarter, normals)) for quarter in _children(points, normals, spacing)]
    return tuple(np.mean(values, axis=0) for values in zip(*looks, strict=True))


def _refined(
    points: Array, normals: Array, spacing: float, labeller: Labeller
) -> tuple[Array, ...]:
    """Points, normals, spacing and appearance; patches of several materials are quartered."""
    edge = np.full(len(points), spacing)
    quarters = _children(points, normals, edge)
    labels = np.stack([labeller(quarter, normals) for quarter in quarters])
    mixed = np.any(labels != labels[0], axis=0) & (labels[0] != Material.DARK)
    finer = quarters[:, mixed].reshape(-1, 3)
    points = np.concatenate([points[~mixed], finer])
    edge = np.concatenate([edge[~mixed], np.full(len(finer), spacing / 2)])
    normals = np.concatenate([normals[~mixed], np.tile(normals[mixed], (4, 1))])
    return (points, normals, edge, *_appearance(points, normals, edge, labeller))
