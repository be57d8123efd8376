"""Rays: queries against triangles, arithmetic on their vectors, and directions to sample.

numpy broadcasts (N, 1) against (N, 3) in loops of length three; the arithmetic here, on (N, 3)
float32 vectors, which embree wants in that layout, goes column by column instead. That takes a
third of the time, as does `np.take` of rows compared with an index in brackets.

Samples are spread so that neighbouring pixels complete one another. Every aligned block of 8 x 8
pixels holds the first 64 points of Sobol's (0, 2)-sequence in Morton order, so that each aligned
2 x 2 and 4 x 4 block is stratified as well; a filter over a few pixels then sees as many well
spread samples. Each block is shifted at random (Cranley-Patterson rotation).
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array, BoolArray, Float32Array
from recast.core.errors import InputError
from recast.synthetic.rendering.embree import PacketScene, packets_work
from recast.synthetic.surface import Surface

NO_HIT = np.float32(1e37)
"""Embree's distance of a ray that met nothing."""
TILE = 8


class MeshHits(NamedTuple):
    """First hits on one mesh: distance (N,) in ray lengths, `NO_HIT` where none; face; u, v."""

    distance: Float32Array
    face: NDArray[np.int32]
    u: Float32Array
    v: Float32Array


class RayMesh:
    """The bounding volume hierarchy of one surface, in the surface's own frame.

    Args:
        surface: surface to hit; where it is empty, nothing is ever hit.

    Raises:
        InputError: embreex is not installed.
    """

    def __init__(self, surface: Surface) -> None:
        rtcore_scene, mesh_construction = _embreex()
        triangles = surface.vertices[surface.faces].astype(np.float32)
        self._scene: Any = None
        self._packets: PacketScene | None = None
        if len(triangles) and packets_work():
            self._packets = PacketScene(triangles)
        elif len(triangles):
            self._scene = rtcore_scene.EmbreeScene()
            self._geometry = mesh_construction.TriangleMesh(self._scene, triangles)
            # The hierarchy is built by the first query; a worker forked later then shares it.
            self.occluded(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def first_hits(
        self,
        origins: Float32Array,
        directions: Float32Array,
        limit: Float32Array | None = None,
        *,
        coherent: bool = False,
    ) -> MeshHits:
        """Nearest hits of rays (N, 3), (N, 3), nearer than `limit` (N,) where given.

        Args:
            coherent: neighbouring rays lie close together: sooner then, later where they do not.
        """
        count = len(origins)
        if self._packets is not None and count:
            return MeshHits(*self._packets.first_hits(origins, directions, limit, coherent))
        if self._scene is None or not count:
            far, none = np.full(count, NO_HIT), np.full(count, -1, np.int32)
            return MeshHits(far, none, np.zeros(count, np.float32), np.zeros(count, np.float32))
        # Embree writes into the limits.
        far = np.full(count, NO_HIT) if limit is None else limit.astype(np.float32)
        found = self._scene.run(origins, directions, dists=far, output=1)
        missed = found["primID"] < 0
        distance = found["tfar"]
        distance[missed] = NO_HIT
        return MeshHits(distance, found["primID"], found["u"], found["v"])

    def occluded(
        self, origins: Float32Array, directions: Float32Array, *, coherent: bool = False
    ) -> BoolArray:
        """Whether rays (N, 3), (N, 3) meet anything; `coherent` as in `first_hits`."""
        if self._packets is not None and len(origins):
            return self._packets.occluded(origins, directions, coherent)
        if self._scene is None or not len(origins):
            return np.zeros(len(origins), bool)
        return self._scene.run(origins, directions, query="OCCLUDED") >= 0


def require_embree() -> None:
    """Refuse early what needs the ray tracer.

    Raises:
        InputError: embreex is not installed.
    """
    _embreex()


def _embreex() -> tuple[Any, Any]:
    try:
        return (
            importlib.import_module("embreex.rtcore_scene"),
            importlib.import_module("embreex.mesh_construction"),
        )
    except ImportError:
        raise InputError(
            "embreex", "module", "is not installed", "pip install 'recast-sim[synthetic]'"
        ) from None


def dot(first: Float32Array, second: Float32Array) -> Float32Array:
    """Scalar products (N,) of rows (N, 3)."""
    total = first[:, 0] * second[:, 0]
    total += first[:, 1] * second[:, 1]
    total += first[:, 2] * second[:, 2]
    return total


def scale(vectors: Float32Array, factors: Float32Array) -> Float32Array:
    """Rows (N, 3) times factors (N,), in place."""
    for column in range(vectors.shape[1]):
        vectors[:, column] *= factors
    return vectors


def scaled(vectors: Float32Array, factors: Float32Array) -> Float32Array:
    """Rows (N, 3) times factors (N,)."""
    product = np.empty_like(vectors)
    for column in range(vectors.shape[1]):
        np.multiply(vectors[:, column], factors, out=product[:, column])
    return product


def outer(factors: Float32Array, vector: Float32Array) -> Float32Array:
    """Factors (N,) times one vector (3,): (N, 3)."""
    product = np.empty((len(factors), 3), np.float32)
    for column in range(3):
        np.multiply(factors, vector[column], out=product[:, column])
    return product


def shift(vectors: Float32Array, amount: Float32Array) -> Float32Array:
    """Rows (N, 3) plus one vector (3,), in place."""
    for column in range(3):
        vectors[:, column] += amount[column]
    return vectors


def normalise(vectors: Float32Array) -> Float32Array:
    """Rows (N, 3), none of them zero, at unit length, in place."""
    length = dot(vectors, vectors)
    np.sqrt(length, out=length)
    return scale(vectors, np.divide(np.float32(1), length, out=length))


def rows(array: np.ndarray, index: np.ndarray) -> np.ndarray:
    """`array[index]` for whole numbers `index`."""
    return np.take(array, index, axis=0)


def _net() -> Float32Array:
    """(8, 8, 2) the first 64 points of the (0, 2)-sequence, in Morton order."""
    index = np.arange(TILE * TILE)
    bits = (index[:, None] >> np.arange(6)) & 1
    radical = bits @ (0.5 ** np.arange(1, 7))
    # Second Sobol dimension: direction numbers of the Pascal matrix modulo 2.
    pascal = np.array([[1 if (row & col) == row else 0 for col in range(6)] for row in range(6)])
    second = ((bits @ pascal.T) % 2) @ (0.5 ** np.arange(1, 7))
    x = bits[:, 0] + 2 * bits[:, 2] + 4 * bits[:, 4]
    y = bits[:, 1] + 2 * bits[:, 3] + 4 * bits[:, 5]
    tile = np.zeros((TILE, TILE, 2), np.float32)
    tile[y, x] = np.stack([radical, second], axis=1)
    return tile


_NET = _net()


def pixel_samples(height: int, width: int, rng: np.random.Generator) -> Float32Array:
    """One point (height, width, 2) of [0, 1)^2 a pixel, stratified over neighbouring pixels."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    shift = rng.random((rows, 1, columns, 1, 2), np.float32)
    points = shift + _NET[None, :, None, :, :]
    points -= points >= 1  # the remainder of 1, at a fifth of its cost
    points = points.reshape(rows * TILE, columns * TILE, 2)
    return np.ascontiguousarray(points[:height, :width])


def cosine_directions(normals: Float32Array, samples: Float32Array) -> Float32Array:
    """Unit directions (N, 3) about unit normals (N, 3), in proportion to the cosine.

    Points of the unit sphere about the normal's tip, seen from its foot.
    """
    z = 1 - 2 * samples[:, 0]
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    angle = np.float32(2 * np.pi) * samples[:, 1]
    directions = normals * np.float32(1.0001)  # never exactly opposite: a direction of length zero
    directions[:, 0] += radius * np.cos(angle)
    directions[:, 1] += radius * np.sin(angle)
    directions[:, 2] += z
    return normalise(directions)


def disc_directions(centre: Array, radius: float, samples: Float32Array) -> Float32Array:
    """Unit directions (N, 3) to points of a disc of angular `radius` about the unit `centre`."""
    side = np.cross(centre, [1.0, 0, 0] if abs(centre[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    reach = np.sqrt(samples[:, 0]) * np.float32(np.tan(radius))
    angle = np.float32(2 * np.pi) * samples[:, 1]
    axes = np.stack([side, np.cross(centre, side)]).astype(np.float32)
    plane = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    return normalise(shift(plane @ axes, centre.astype(np.float32)))
