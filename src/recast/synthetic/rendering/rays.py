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
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, BoolArray, Float32Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.compiled import PacketScene, packets_work
from recast.synthetic.surface import Surface, concatenate, corner_normals

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


# The scene that rays are cast into: what never moves, and vehicles at any pose.
#
# Every vehicle keeps its hierarchy in its own frame, built once; a query moves the rays that can
# meet the vehicle's bounding sphere into that frame. Rebuilding a posed mesh would cost 40 ms for
# 20,000 triangles, this costs 1 to 3 ms for a camera's rays.

Poses = Mapping[str, Array]

STREET = 0
"""Instance id of what never moves; the i-th of the sorted model names has i + 1."""
SKY = 65535
"""Instance id of rays that meet nothing."""


class FaceAttributes:
    """Attributes of the faces of several surfaces, each in its own frame, one after the other.

    Attributes:
        first: (S + 1,) row of each surface's first face.
        corner_normals: (F, 3, 3) float32 unit shading normals.
        flat_normals: (F, 3) float32 unit normals; zero for a face without area.
        colours: (F, 3) float32.
        materials: (F,) uint8.
    """

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self.first = np.cumsum([0, *(len(surface) for surface in surfaces)])
        self.corner_normals = np.concatenate([surface.normals for surface in surfaces])
        self.colours = np.concatenate([surface.colours for surface in surfaces])
        self.materials = np.concatenate([surface.materials for surface in surfaces])
        flat = [corner_normals(surface.vertices, surface.faces, 0.0) for surface in surfaces]
        self.flat_normals = np.concatenate(flat)[:, 0].copy()

    def with_surfaces(self, changed: Mapping[int, Surface]) -> FaceAttributes:
        """The attributes with other surfaces, of as many faces, in the places of some. Raises
        ValueError: a surface has another number of faces than the one in its place."""
        places, parts = list(changed), FaceAttributes([*changed.values()])
        found = copy(self)
        for name in ("corner_normals", "flat_normals", "colours", "materials"):
            setattr(found, name, getattr(self, name).copy())
        for k, place in enumerate(places):
            own, new = slice(*self.first[[place, place + 1]]), slice(*parts.first[[k, k + 1]])
            if own.stop - own.start != new.stop - new.start:
                raise ValueError(f"surface {place}: {new.stop - new.start} faces, not as before")
            for name in ("corner_normals", "flat_normals", "colours", "materials"):
                getattr(found, name)[own] = getattr(parts, name)[new]
        return found


@dataclass(frozen=True)
class Hits:
    """Where rays first meet a surface.

    Attributes:
        distance: (N,) float32 metres for unit directions, inf where nothing is met.
        instance: (N,) uint16, `STREET`, 1 + index in the sorted model names, or `SKY`.
        face: (N,) int32 index into that surface's faces, -1 where nothing is met.
        u, v: (N,) float32 barycentric weights of the face's second and third corner.
    """

    distance: Float32Array
    instance: NDArray[np.uint16]
    face: NDArray[np.int32]
    u: Float32Array
    v: Float32Array


class RayScene:
    """A street and the models of vehicles that can be placed in it.

    Embree objects cannot be sent to another process: build the scene before forking, or in each.

    Args:
        static: what never moves, world frame; may be empty.
        models: surfaces by name, each in its actor-local frame.

    Raises:
        InputError: embreex is not installed.
    """

    def __init__(self, static: Surface, models: Mapping[str, Surface]) -> None:
        self.static = static
        self.models = dict(models)
        self.names: tuple[str, ...] = tuple(sorted(models))
        self._meshes = [RayMesh(static), *(RayMesh(models[name]) for name in self.names)]
        self.bounds = [_bounds(static), *(_bounds(models[name]) for name in self.names)]
        self.attributes = FaceAttributes([static, *(models[name] for name in self.names)])

    def with_models(self, changed: Mapping[str, Surface]) -> RayScene:
        """The same scene in which some models have another shape, of as many faces. Raises
        ValueError: a name is not among the models, or a shape has another number of faces."""
        unknown = sorted(set(changed) - set(self.names))
        if unknown:
            raise ValueError(f"changed: {unknown} not among the models {list(self.names)}")
        scene = RayScene.__new__(RayScene)
        scene.static, scene.names = self.static, self.names
        scene.models = {**self.models, **changed}
        scene._meshes, scene.bounds = list(self._meshes), list(self.bounds)
        places = {1 + self.names.index(name): surface for name, surface in changed.items()}
        for place, surface in places.items():
            scene._meshes[place], scene.bounds[place] = RayMesh(surface), _bounds(surface)
        scene.attributes = self.attributes.with_surfaces(places)
        return scene

    def posed(self, poses: Poses) -> PosedScene:
        """The scene with the models named in `poses` at `world_from_actor` (4, 4), others absent.
        Raises ValueError: a name is not among the models."""
        return PosedScene(self, poses)

    def cast(self, origins: ArrayLike, directions: ArrayLike, poses: Poses) -> Hits:
        """First hits of rays from `origins` (N, 3) or (3,) along unit `directions` (N, 3)."""
        directions = np.ascontiguousarray(directions, np.float32).reshape(-1, 3)
        origins = np.asarray(origins, np.float32).reshape(-1, 3)
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape))
        return self.posed(poses).cast(origins, directions)

    def mesh(self, instance: int) -> RayMesh:
        """The hierarchy of one instance."""
        return self._meshes[instance]


class PosedScene:
    """A `RayScene` at one moment; made by `RayScene.posed`."""

    def __init__(self, scene: RayScene, poses: Poses) -> None:
        unknown = sorted(set(poses) - set(scene.names))
        if unknown:
            raise ValueError(f"poses: {unknown} not among the models {list(scene.names)}")
        self.scene = scene
        self.poses = dict(poses)
        count = len(scene.names) + 1
        self.rotation = np.tile(np.eye(3, dtype=np.float32), (count, 1, 1))
        self.translation = np.zeros((count, 3), np.float32)
        actors: list[tuple[int, Array]] = []
        spheres: list[tuple[Array, float]] = []
        for instance, name in enumerate(scene.names, 1):
            surface = scene.models[name]
            if name not in poses or not len(surface):
                continue
            pose = np.asarray(poses[name], np.float64)
            self.rotation[instance], self.translation[instance] = pose[:3, :3], pose[:3, 3]
            low, high = scene.bounds[instance]
            actors.append((instance, se3.inverse(pose)))
            centre = se3.apply(pose, ((low + high) / 2)[None])[0]
            spheres.append((centre, float(np.linalg.norm(high - low)) / 2))
        self._actors = actors
        self._spheres = _Spheres(spheres)

    def cast(
        self,
        origins: Float32Array,
        directions: Float32Array,
        *,
        coherent: bool = False,
        street: bool = True,
    ) -> Hits:
        """First hits of rays from `origins` (N, 3) along unit `directions` (N, 3), contiguous.

        Args:
            coherent: neighbouring rays lie close together: sooner then, later where they do not.
            street: False lets the rays pass through what never moves.
        """
        mesh = self.scene.mesh(STREET) if street else RayMesh(concatenate([]))
        distance, face, u, v = mesh.first_hits(origins, directions, coherent=coherent)
        instance = np.where(face >= 0, np.uint16(STREET), np.uint16(SKY))
        enter = self._spheres.entered(origins, directions)
        for (index, local), entry in zip(self._actors, enter, strict=True):
            rays = np.flatnonzero(entry < distance)
            if not len(rays):
                continue
            moved = _move(local, rows(origins, rays), rows(directions, rays))
            hits = self.scene.mesh(index).first_hits(*moved, distance[rays], coherent=coherent)
            hit = hits.face >= 0
            at = rays[hit]
            distance[at], face[at] = hits.distance[hit], hits.face[hit]
            u[at], v[at], instance[at] = hits.u[hit], hits.v[hit], index
        distance[face < 0] = np.inf
        return Hits(distance, instance, face, u, v)

    def occluded(
        self, origins: Float32Array, directions: Float32Array, *, coherent: bool = False
    ) -> BoolArray:
        """Whether rays from `origins` (N, 3) along unit `directions` (N, 3) meet anything."""
        blocked = self.scene.mesh(STREET).occluded(origins, directions, coherent=coherent)
        free = np.flatnonzero(~blocked)
        if not self._actors or not len(free):
            return blocked
        enter = self._spheres.entered(rows(origins, free), rows(directions, free))
        for (index, local), entry in zip(self._actors, enter, strict=True):
            rays = free[entry < np.inf]
            rays = rays[~blocked[rays]]
            if len(rays):
                moved = _move(local, rows(origins, rays), rows(directions, rays))
                blocked[rays] = self.scene.mesh(index).occluded(*moved, coherent=coherent)
        return blocked


class _Spheres:
    """Bounding spheres of the posed models, all tested at once."""

    def __init__(self, spheres: list[tuple[Array, float]]) -> None:
        # Relative to the spheres' mean, so that float32 keeps its digits far from the origin.
        centres = np.array([centre for centre, _ in spheres]).reshape(-1, 3)
        middle = centres.mean(axis=0) if len(centres) else np.zeros(3)
        self._middle = middle.astype(np.float32)
        self._centres = (centres - self._middle).astype(np.float32)
        self._radii = np.array([radius + 0.05 for _, radius in spheres], np.float32)

    def entered(self, origins: Float32Array, directions: Float32Array) -> Float32Array:
        """Distance (spheres, N) at which rays enter, at most; inf where they miss."""
        if not len(self._centres):
            return np.zeros((0, len(origins)), np.float32)
        origins = shift(origins.copy(), -self._middle)
        entry = compiled.entered(self._centres, self._radii, origins, directions)
        if entry is not None:
            return entry
        own = dot(origins, origins)
        along = self._centres @ directions.T
        along -= dot(origins, directions)
        squared = self._centres @ origins.T
        squared *= -2
        squared += own
        squared += np.einsum("ij,ij->i", self._centres, self._centres)[:, None]
        reach = (self._radii**2)[:, None]
        outside = squared > reach
        squared -= along * along
        missed = squared > reach
        missed |= outside & (along < 0)
        along -= self._radii[:, None]
        along[missed] = np.inf
        return along


def _bounds(surface: Surface) -> Array:
    return surface.bounds() if len(surface) else np.zeros((2, 3))


def _move(
    local_from_world: Array, origins: Float32Array, directions: Float32Array
) -> tuple[Float32Array, Float32Array]:
    rotation = local_from_world[:3, :3].astype(np.float32)
    offset = local_from_world[:3, 3].astype(np.float32)
    return shift(origins @ rotation.T, offset), directions @ rotation.T
