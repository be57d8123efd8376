"""What lies where rays met the scene: position, normals, colour, material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.materials import MATERIALS
from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.ray_scene import SKY, STREET, Hits, PosedScene
from recast.synthetic.rendering.vectors import dot, normalise, rows, scale, scaled


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
        origin = scaled(self.flat, lift)
        origin += self.position
        return origin

    @cached_property
    def cosine(self) -> Float32Array:
        """Of the angle (N,) between viewer and shading normal."""
        return np.clip(-dot(self.view, self.normal), 0, 1)

    def local(self, index: NDArray[np.int64]) -> tuple[Float32Array, Float32Array]:
        """Position and flat normal (M, 3) of some, in the frame of the surface they belong to."""
        position, flat = rows(self.position, index), rows(self.flat, index)
        instance = rows(self.instance, index)
        moved = np.flatnonzero(instance != STREET)
        if len(moved):
            which = instance[moved]
            rotation = self.posed.rotation[which]
            shifted = position[moved] - self.posed.translation[which]
            position[moved] = np.einsum("ij,ijk->ik", shifted, rotation)
            flat[moved] = np.einsum("ij,ijk->ik", flat[moved], rotation)
        return position, flat

    def take(self, index: NDArray[np.int64]) -> SurfacePoints:
        """Some of the points."""
        return SurfacePoints(
            rows(self.position, index),
            rows(self.view, index),
            rows(self.distance, index),
            rows(self.flat, index),
            rows(self.normal, index),
            rows(self.colour, index),
            rows(self.material, index),
            rows(self.instance, index),
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
    *,
    smooth: bool = True,
) -> tuple[NDArray[np.int64], SurfacePoints]:
    """The points that rays met, and the indices of those rays.

    Args:
        origins, directions: (N, 3) of the rays cast.
        hits: what they met.
        rays: only these; all that met something when None.
        smooth: False takes the faces' own normals for shading: enough where nobody looks.
    """
    if rays is None:
        rays = np.flatnonzero(hits.instance != SKY)
    attributes = posed.scene.attributes
    instance = rows(hits.instance, rays)
    face = rows(hits.face, rays) + rows(attributes.first, instance)
    view, distance = rows(directions, rays), rows(hits.distance, rays)
    moved = np.flatnonzero(instance != STREET)
    rotation = posed.rotation[instance[moved]]
    flat = rows(attributes.flat_normals, face)
    flat[moved] = np.einsum("ikj,ij->ik", rotation, flat[moved])
    # Both sides of a face are seen; its normal looks at the viewer.
    side = np.where(dot(view, flat) > 0, np.float32(-1), np.float32(1))
    scale(flat, side)
    normal = flat
    if smooth:
        u, v = rows(hits.u, rays), rows(hits.v, rays)
        corners = rows(attributes.corner_normals, face)
        normal = scaled(corners[:, 0], 1 - u - v)
        normal += scaled(corners[:, 1], u)
        normal += scaled(corners[:, 2], v)
        normal[moved] = np.einsum("ikj,ij->ik", rotation, normal[moved])
        scale(normal, side)
        # Near an outline a shading normal may look away: bend it back to a right angle.
        normal -= scaled(view, np.maximum(dot(view, normal), 0))
        normal += flat * np.float32(1e-4)
        normalise(normal)
    position = scaled(view, distance)
    position += rows(origins, rays)
    points = SurfacePoints(
        position=position,
        view=view,
        distance=distance,
        flat=flat,
        normal=normal,
        colour=rows(attributes.colours, face),
        material=rows(attributes.materials, face),
        instance=instance,
        posed=posed,
    )
    return rays, points
