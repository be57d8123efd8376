"""What lies where rays met the scene: position, normals, colour, material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.materials import MATERIALS
from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.ray_scene import SKY, STREET, Hits, PosedScene
from recast.synthetic.rendering.sampling import normalise


@dataclass(frozen=True)
class MaterialTable:
    """The fields of `MATERIALS` as arrays over material indices."""

    specular: Float32Array
    roughness: Float32Array
    metallic: NDArray[np.bool_]
    emission: Float32Array
    lidar: Float32Array
    retroreflective: NDArray[np.bool_]


def _material_table() -> MaterialTable:
    def column(name: str, dtype: type) -> NDArray:
        return np.array([getattr(material, name) for material in MATERIALS], dtype)

    return MaterialTable(
        column("specular", np.float32),
        column("roughness", np.float32),
        column("metallic", np.bool_),
        column("emission", np.float32),
        column("lidar", np.float32),
        column("retroreflective", np.bool_),
    )


TABLE = _material_table()


@dataclass
class SurfacePoints:
    """N points on surfaces; arrays of length N, world frame.

    Attributes:
        position: (N, 3) float32.
        view: (N, 3) unit direction of the ray that came here.
        distance: (N,) along that ray.
        flat: (N, 3) unit normal of the face, turned to the viewer.
        normal: (N, 3) unit shading normal, turned to the viewer.
        colour: (N, 3) diffuse colour, before any texture.
        material: (N,) index into `MATERIALS`.
        instance: (N,).
    """

    position: Float32Array
    view: Float32Array
    distance: Float32Array
    flat: Float32Array
    normal: Float32Array
    colour: Float32Array
    material: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    posed: PosedScene

    @cached_property
    def origin(self) -> Float32Array:
        """Where rays that leave the surface start: lifted off it by its rounding error."""
        lift = np.float32(2e-3) + np.float32(3e-5) * self.distance
        return self.position + self.flat * lift[:, None]

    @cached_property
    def cosine(self) -> Float32Array:
        """Of the angle (N,) between viewer and shading normal."""
        return np.clip(-np.einsum("ij,ij->i", self.view, self.normal), 0, 1)

    def local(self) -> tuple[Float32Array, Float32Array]:
        """Position and flat normal (N, 3) in the frame of the surface that they belong to."""
        position, flat = self.position.copy(), self.flat.copy()
        moved = np.flatnonzero(self.instance != STREET)
        if len(moved):
            which = self.instance[moved]
            rotation = self.posed.rotation[which]
            shifted = position[moved] - self.posed.translation[which]
            position[moved] = np.einsum("ij,ijk->ik", shifted, rotation)
            flat[moved] = np.einsum("ij,ijk->ik", flat[moved], rotation)
        return position, flat

    def take(self, index: NDArray[np.int64]) -> SurfacePoints:
        """Some of the points."""
        return SurfacePoints(
            self.position[index],
            self.view[index],
            self.distance[index],
            self.flat[index],
            self.normal[index],
            self.colour[index],
            self.material[index],
            self.instance[index],
            self.posed,
        )

    def __len__(self) -> int:
        return len(self.position)


def surface_points(
    posed: PosedScene,
    origins: Float32Array,
    directions: Float32Array,
    hits: Hits,
    rays: NDArray[np.int64] | None = None,
) -> tuple[NDArray[np.int64], SurfacePoints]:
    """The points that rays met, and the indices of those rays.

    Args:
        origins, directions: (N, 3) of the rays cast.
        hits: what they met.
        rays: only these; all that met something when None.
    """
    if rays is None:
        rays = np.flatnonzero(hits.instance != SKY)
    attributes = posed.scene.attributes
    instance = hits.instance[rays]
    face = hits.face[rays] + attributes.first[instance]
    view, distance = directions[rays], hits.distance[rays]
    u, v = hits.u[rays][:, None], hits.v[rays][:, None]
    corners = attributes.corner_normals[face]
    normal = corners[:, 0] * (1 - u - v)
    normal += corners[:, 1] * u
    normal += corners[:, 2] * v
    flat = attributes.flat_normals[face]
    moved = np.flatnonzero(instance != STREET)
    if len(moved):
        rotation = posed.rotation[instance[moved]]
        normal[moved] = np.einsum("ikj,ij->ik", rotation, normal[moved])
        flat[moved] = np.einsum("ikj,ij->ik", rotation, flat[moved])
    behind = np.einsum("ij,ij->i", view, flat) > 0
    flat[behind] *= -1
    normal[behind] *= -1
    # A shading normal may turn away from the viewer near an outline: bend it back to a right angle.
    facing = np.einsum("ij,ij->i", view, normal)
    normal -= view * np.maximum(facing, 0)[:, None]
    normal += flat * np.float32(1e-4)
    points = SurfacePoints(
        position=origins[rays] + view * distance[:, None],
        view=view,
        distance=distance,
        flat=flat,
        normal=normalise(normal),
        colour=attributes.colours[face],
        material=attributes.materials[face],
        instance=instance,
        posed=posed,
    )
    return rays, points
