"""The scene that rays are cast into: what never moves, and vehicles at any pose.

Every vehicle keeps its hierarchy in its own frame, built once; a query moves the rays that can meet
the vehicle's bounding sphere into that frame. Rebuilding a posed mesh would cost 40 ms for 20,000
triangles, this costs 1 to 3 ms for a camera's rays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.geometry import se3
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.rays import BoolArray, Float32Array, RayMesh, dot, rows, shift
from recast.synthetic.surface import Surface, concatenate, corner_normals

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
        """The attributes with other surfaces, of as many faces, in the places of some.

        Raises:
            ValueError: a surface has another number of faces than the one in its place.
        """
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
        """The same scene in which some models have another shape, of as many faces.

        Raises:
            ValueError: a name is not among the models, or a shape has another number of faces.
        """
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

        Raises:
            ValueError: a name is not among the models.
        """
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
