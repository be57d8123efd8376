"""Trees: a trunk and a crown of leaves, or tiers of drooping branches.

Leaves are lumpy opaque cores, and a skin of small irregular sprays that breaks up the outline.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Float32Array
from recast.synthetic.surface import (
    Surface,
    boxes,
    choose,
    concatenate,
    lathe,
    quads,
    require_known,
    require_size,
    sheet,
    stations,
    tube,
)

SPRAY_SHAPE = np.array([1.25, 0.6, 1.1, 0.6])
"""How far a spray's four corners reach: pointed at both ends."""

CORE_SHADE = 0.55
"""Leaves deep inside get this share of the outer leaves' colour: they shade each other."""
TIERS = 17
FANS = 15
"""Branches in the lowest tier of full detail, 4 triangles each; fewer further up."""


@cache
def icosphere(level: int) -> tuple[Array, NDArray[np.int32]]:
    """Unit sphere of 20 * 4^level triangles: vertices (V, 3), faces (F, 3)."""
    golden = (1 + 5**0.5) / 2
    first = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices = np.array([np.roll(v, k) for k in (0, 1, 2) for v in first], np.float64)
    vertices /= np.linalg.norm(vertices[0])
    # The 20 faces are the triples of vertices at edge length from each other.
    near = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 1.1
    np.fill_diagonal(near, False)
    faces = np.array([t for t in combinations(range(12), 3) if near[np.ix_(t, t)].sum() == 6])
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(level):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].mean(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        m = index.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, middle])
        a, b, c = faces.T
        ab, bc, ca = m.T
        quarters = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return vertices, faces.astype(np.int32)


def directions(rng: np.random.Generator, count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere, turned and jittered at random."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + 5**0.5) * k + rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - z**2)
    points = np.column_stack([flat * np.cos(angle), flat * np.sin(angle), z])
    points += rng.normal(0, 0.6 / np.sqrt(count), points.shape)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def cores(
    rng: np.random.Generator, centres: Array, radii: Array, colour: ArrayLike, level: int
) -> Surface:
    """Lumpy closed bodies.

    Args:
        centres: (N, 3) metres.
        radii: (N, 3) half axes, metres.
        colour: (3,) colour of outer leaves; the cores are darker.
        level: level of the icosphere, see `icosphere`.
    """
    sphere, faces = icosphere(level)
    count = len(centres)
    swell = 1 + rng.normal(0, 0.11, (count, len(sphere), 1))
    vertices = centres[:, None] + sphere * swell * radii[:, None]
    all_faces = (faces + len(sphere) * np.arange(count)[:, None, None]).reshape(-1, 3)
    shade = CORE_SHADE * rng.uniform(0.75, 1.2, (len(all_faces), 1))
    return Surface.make(
        vertices.reshape(-1, 3), all_faces, np.asarray(colour) * shade, "foliage", np.pi / 2
    )


def sprays(
    rng: np.random.Generator,
    points: Array,
    outward: Array,
    size: float,
    colour: ArrayLike,
    tilt: float = 0.8,
) -> Surface:
    """Small ragged pieces of two triangles each, that overlap like leaves on twigs.

    Args:
        points: (N, 3) metres, their middles.
        outward: (N, 3) unit vectors that they face, roughly; also their shading normal, so that a
            crown is shaded as one body.
        size: metres across.
        colour: (3,) or (N, 3) linear RGB.
        tilt: random tilt, as the standard deviation added to the unit vectors.
    """
    count = len(points)
    facing = outward + rng.normal(0, tilt, (count, 3))
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    # A spray that faces inwards would be seen from behind; turn it round.
    facing *= np.where(np.einsum("ij,ij->i", facing, outward) < 0, -1.0, 1.0)[:, None]
    side = np.cross(facing, rng.normal(0, 1, (count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(facing, side)
    angle = 2 * np.pi * (np.arange(4) + rng.uniform(-0.3, 0.3, (count, 4))) / 4
    reach = 0.5 * size * rng.uniform(0.7, 1.3, (count, 4)) * SPRAY_SHAPE
    across = (reach * np.cos(angle))[..., None] * side[:, None]
    along = (reach * np.sin(angle))[..., None] * up[:, None]
    normal = 0.75 * outward + 0.45 * facing
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shade = rng.uniform(0.72, 1.3, (count, 1)) * np.column_stack(
        [rng.uniform(0.85, 1.2, count), np.ones(count), rng.uniform(0.8, 1.1, count)]
    )
    colours = np.clip(np.asarray(colour) * shade, 0, 1)
    flat = quads(points[:, None] + across + along, colours, "foliage")
    return replace(flat, normals=_for_corners(np.repeat(normal, 2, axis=0)))


def _for_corners(normals: Array) -> Float32Array:
    """One normal (F, 3) a face, for all its corners."""
    return np.repeat(normals[:, None], 3, axis=1).astype(np.float32)


def conifer(rng: np.random.Generator, height: float, detail: float) -> Surface:
    """A conifer of `height` metres at the origin: tiers of drooping branches round a dark core."""
    green = choose(rng, "needles") * rng.uniform(0.85, 1.25)
    low = height * rng.uniform(0.06, 0.14)
    half = height * rng.uniform(0.18, 0.27)
    stem = [(0.022 * height, -0.2), (0.016 * height, 0.1 * height), (0.006 * height, 0.8 * height)]
    cone = [(0.0, low + 0.02 * height), (0.45 * half, low + 0.04 * height), (0.0, 0.96 * height)]
    trunk = lathe(stem, 7, (0.09, 0.065, 0.05), "bark")
    core = lathe(cone, 9, 0.4 * green, "foliage")
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
    places = ((0.0, 0, -0.35), (0.6, 0, 0.25), (1.0, 0, 1.0), (0.55, -1, 0.75), (0.62, 1, 0.75))
    corners = np.stack([point(*place) for place in places], axis=1)
    corners[..., 2] = np.clip(corners[..., 2], 0.05, height)
    kite = np.array([(0, 3, 1), (3, 2, 1), (1, 2, 4), (0, 1, 4)], np.int32)
    faces = (kite + 5 * np.arange(count, dtype=np.int32)[:, None, None]).reshape(-1, 3)
    normal = radial * 0.8 + up * 0.6
    normal = normal[:, None] + np.array([-0.35, -0.35, 0.35, 0.35])[:, None] * across[:, None]
    normal = (normal / np.linalg.norm(normal, axis=2, keepdims=True)).reshape(-1, 3)
    shade = np.repeat(rng.uniform(0.7, 1.25, (count, 1)), 4, axis=0)
    # The new growth at the tips is lighter.
    shade *= np.tile([0.85, 1.2, 1.2, 0.85], count)[:, None]
    flat = Surface.make(corners, faces, np.clip(green * shade, 0, 1), "foliage", 0.0)
    return replace(flat, normals=_for_corners(normal))


TREE_STYLES = ("round", "conifer", "tall")

SPRAYS = 1080
"""In a broad-leaved tree of full detail; two triangles each."""


def tree(
    rng: np.random.Generator, height: float, style: str = "round", detail: float = 1.0
) -> Surface:
    """A tree whose trunk stands at the origin, its crown within 0.45 * height of it.

    Args:
        height: metres, 1.5 to 30.
        style: "round" (broad-leaved), "conifer" or "tall" (poplar).
        detail: share of the triangles to spend, 0.2 to 1.
    """
    require_size("tree", "height", height, 1.5, 30.0)
    require_size("tree", "detail", detail, 0.2, 1.0)
    require_known("tree", "style", style, TREE_STYLES)
    if style == "conifer":
        return conifer(rng, height, detail)
    return _broad_leaved(rng, height, style == "tall", detail)


def _broad_leaved(rng: np.random.Generator, height: float, slim: bool, detail: float) -> Surface:
    green = choose(rng, "greens") * rng.uniform(0.85, 1.2)
    bark = choose(rng, "barks") * rng.uniform(0.8, 1.2)
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
        z = np.minimum(low + tall * (0.08 + 0.86 * share), height - 0.15 * tall)
        centres = np.column_stack([offset * np.cos(angle), offset * np.sin(angle), z])
        across = width * rng.uniform(0.75, 0.95, count)
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
        thick = foot * np.array([0.5, 0.36, 0.2])
        for target in centres[order]:
            knee = 0.5 * (start + target) + [0, 0, -0.02 * height]
            parts.append(tube([start, knee, target], thick, 5, bark, "bark"))
    return concatenate(parts)


FENCE_STYLES = ("wood", "picket", "mesh", "iron")

STEEL = (0.62, 0.63, 0.64)


def fence(rng: np.random.Generator, length: float, style: str = "wood") -> Surface:
    """A fence centred on y = 0.

    Args:
        length: metres, 0.5 to 500.
        style: "wood" (boards, 1.5 to 1.9 m), "picket" (1 m), "mesh" (2 m) or "iron" (1.2 m).
    """
    require_size("fence", "length", length, 0.5, 500.0)
    require_known("fence", "style", style, FENCE_STYLES)
    return {"wood": _boards, "picket": _pickets, "mesh": _mesh, "iron": _iron}[style](rng, length)


def _posts(xs: np.ndarray, half: float, height: float, colour: ArrayLike, material: str) -> Surface:
    low = np.array([(x - half, -half, -0.2) for x in xs])
    size = np.array([2 * half, 2 * half, height + 0.2])
    return boxes(low, low + size, colour, material, bottom=False)


def _rails(length: float, heights: tuple[float, ...], y: float, colour: ArrayLike) -> Surface:
    low = np.array([(0.0, y, z) for z in heights])
    return boxes(low, low + np.array([length, 0.04, 0.08]), colour, "wood")


def _boards(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.5, 1.9)
    tone = np.array([(0.24, 0.15, 0.09), (0.30, 0.25, 0.20), (0.16, 0.09, 0.05)][rng.integers(3)])
    xs = stations(length, 0.3)
    count = len(xs) - 1
    top = height + rng.normal(0, 0.012, count)
    y = np.where(np.arange(count) % 2, -0.045, -0.03)
    low = np.column_stack([xs[:-1] + 0.004, y, np.full(count, 0.06)])
    high = np.column_stack([xs[1:] - 0.004, y + 0.02, top])
    planks = boxes(low, high, tone * rng.uniform(0.75, 1.2, (count, 1)), "wood")
    posts = _posts(stations(length, 2.4), 0.05, height + 0.08, tone * 0.8, "wood")
    return concatenate([planks, posts, _rails(length, (0.35, height - 0.35), -0.01, tone * 0.8)])


def _pickets(rng: np.random.Generator, length: float) -> Surface:
    tone = np.array([(0.72, 0.72, 0.69), (0.35, 0.27, 0.18)][int(rng.random() < 0.3)])
    height = rng.uniform(0.9, 1.1)
    xs = stations(length, 0.22)[:-1] + 0.06
    tops = height + rng.normal(0, 0.01, len(xs))
    low, y, right, neck = np.full_like(xs, 0.08), np.full_like(xs, -0.03), xs + 0.1, tops - 0.07
    board = [(xs, y, low), (right, y, low), (right, y, neck), (xs, y, neck)]
    tip = [(xs, y, neck), (right, y, neck), (xs + 0.06, y, tops), (xs + 0.04, y, tops)]
    front = np.concatenate([np.moveaxis(np.array(corners), 2, 0) for corners in (board, tip)])
    back = front[:, ::-1] + [0.0, 0.02, 0.0]
    colour = tone * rng.uniform(0.92, 1.05, (len(xs), 1))
    shapes = quads(np.concatenate([front, back]), np.tile(colour, (4, 1)), "wood")
    posts = _posts(stations(length, 2.2), 0.045, height - 0.05, tone, "wood")
    return concatenate([shapes, posts, _rails(length, (0.25, height - 0.3), -0.01, tone)])


def _mesh(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.8, 2.2)
    paint, material = [(STEEL, "metal"), ((0.03, 0.10, 0.05), "plastic")][rng.integers(2)]
    posts = stations(length, 2.5)
    bars = [tube([[x, 0, -0.2], [x, 0, height + 0.05]], 0.03, 6, paint, material) for x in posts]
    bars += [
        tube([[0, 0, z], [length, 0, z]], 0.012, 4, paint, material)
        for z in (0.08, height / 2, height)
    ]
    xs = stations(length, 0.25)[1:-1]
    low = np.column_stack([xs - 0.006, np.full_like(xs, -0.006), np.full_like(xs, 0.08)])
    wires = boxes(low, low + np.array([0.012, 0.012, height - 0.08]), paint, material, bottom=False)
    return concatenate([*bars, wires])


def _iron(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.1, 1.4)
    paint = [(0.02, 0.022, 0.024), (0.03, 0.07, 0.05)][rng.integers(2)]
    xs = stations(length, 0.16)
    low = np.column_stack([xs - 0.01, np.full_like(xs, -0.01), np.full_like(xs, 0.06)])
    bars = boxes(low, low + np.array([0.02, 0.02, height - 0.06]), paint, "plastic", bottom=False)
    rails = np.array([(0.0, -0.02, 0.12), (0.0, -0.02, height - 0.16)])
    posts = _posts(stations(length, 2.5), 0.035, height + 0.1, paint, "plastic")
    return concatenate(
        [bars, boxes(rails, rails + np.array([length, 0.04, 0.04]), paint, "plastic"), posts]
    )


def bush(rng: np.random.Generator, height: float = 1.0) -> Surface:
    """A bush at the origin, within 0.9 * height of it sideways; one in five is in flower.

    Args:
        height: metres, 0.2 to 4.
    """
    require_size("bush", "height", height, 0.2, 4.0)
    green = choose(rng, "greens") * rng.uniform(0.85, 1.2)
    blossom = choose(rng, "blossoms") if rng.random() < 0.2 else None
    count = int(rng.integers(3, 6))
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(0, 6.3)
    away = height * rng.uniform(0.18, 0.34, count)
    across = height * rng.uniform(0.3, 0.42, count)
    up = height * rng.uniform(0.30, 0.44, count)
    up[0] = 0.46 * height
    centres = np.column_stack([away * np.cos(angle), away * np.sin(angle), up])
    radii = np.column_stack([across, across, 0.98 * up])
    skins = []
    for centre, radius in zip(centres, radii, strict=True):
        out = directions(rng, 130)
        points = centre + out * radius * rng.uniform(0.8, 1.08, (130, 1))
        depth = np.linalg.norm((points - centres[:, None]) / radii[:, None], axis=2).min(axis=0)
        seen = (points[:, 2] > 0.08 * height) & (depth > 0.75)
        colour = np.tile(green, (len(points), 1))
        if blossom is not None:
            colour[rng.random(len(points)) < 0.25] = blossom
        skins.append(sprays(rng, points[seen], out[seen], 0.19 * height, colour[seen], 0.6))
    body = cores(rng, centres, 0.78 * radii, green, 1)
    return _above_ground(concatenate([body, *skins]))


def hedge(
    rng: np.random.Generator, length: float, height: float = 1.4, width: float = 0.8
) -> Surface:
    """A clipped hedge from x = 0 to x = length, centred on y = 0; about 110 triangles a metre.

    Args:
        length, height, width: metres, 0.5 to 500, 0.3 to 4 and 0.2 to 3.
    """
    require_size("hedge", "length", length, 0.5, 500.0)
    require_size("hedge", "height", height, 0.3, 4.0)
    require_size("hedge", "width", width, 0.2, 3.0)
    green = choose(rng, "greens") * rng.uniform(0.8, 1.1)
    parts = [part(rng, length, height, width, green) for part in (_body, _skin)]
    return _above_ground(concatenate(parts))


def _body(
    rng: np.random.Generator, length: float, height: float, width: float, green: np.ndarray
) -> Surface:
    """A long uneven body with rounded shoulders, closed at both ends."""
    y = 0.92 * width / 2 * np.array([-1.0, -1.0, -0.8, 0.0, 0.8, 1.0, 1.0])
    z = height * np.array([0.0, 0.55, 0.93, 0.97, 0.93, 0.55, 0.0])
    steps = max(2, round(length / 0.7))
    xs = np.linspace(0.02, length - 0.02, steps + 1)[:, None]
    rings = np.stack(np.broadcast_arrays(xs, y, z), axis=-1)
    rings = rings + rng.normal(0, 0.02, rings.shape) * [0.5, 1, 1]
    sides = sheet(np.arange(7 * (steps + 1)).reshape(-1, 7))[:, ::-1]
    fan = np.array([(0, k, k + 1) for k in range(1, 6)])
    joined = np.concatenate([sides, fan[:, ::-1], fan + 7 * steps])
    shade = CORE_SHADE * rng.uniform(0.9, 1.1, (len(joined), 1))
    return Surface.make(rings.reshape(-1, 3), joined, green * shade, "foliage")


def _skin(
    rng: np.random.Generator, length: float, height: float, width: float, green: np.ndarray
) -> Surface:
    """Sprays on both sides and the top, 44 a metre, and on the ends."""
    half = width / 2
    count = max(30, round(44 * length))
    x = rng.uniform(0.03, length - 0.03, count)
    girth = 2 * height + width
    s = rng.uniform(0, girth, count)
    left, top = s < height, (s >= height) & (s < height + width)
    y = np.where(left, -half, np.where(top, s - height - half, half))
    z = np.where(left, s, np.where(top, height, girth - s))
    out = np.column_stack([np.zeros(count), np.where(left, -1.0, np.where(top, 0, 1)), 1.0 * top])
    cap = rng.random(count) < min(0.5, 1.2 * width / (length + width))
    x = np.where(cap, np.where(rng.random(count) < 0.5, 0.0, length), x)
    y = np.where(cap, rng.uniform(-half, half, count), y)
    z = np.where(cap, rng.uniform(0, height, count), z)
    out[cap] = np.column_stack([np.where(x[cap] > 0, 1.0, -1.0), np.zeros((cap.sum(), 2))])
    points = np.column_stack([x, y, z]) * [1, 1.0, 0.99] + rng.normal(0, 0.015, (count, 3))
    light = 0.75 + 0.35 * points[:, 2:] / height
    return sprays(rng, points, out, 0.26, green * light, 0.45)


def _above_ground(surface: Surface) -> Surface:
    """With what hangs below the ground pushed up to it."""
    surface.vertices[:, 2] = np.maximum(surface.vertices[:, 2], 0.0)
    return surface
