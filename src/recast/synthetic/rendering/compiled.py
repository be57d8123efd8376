"""Arithmetic of frames in the compiled kernel, where there is one: numpy's bits, sooner.

Every function here says, by None or False, that nothing is compiled; its caller then computes the
same in numpy, which is the reference. csrc/frames.cpp holds the other side.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recast import kernel
from recast.arrays import Float32Array, Int64Array

if TYPE_CHECKING:
    from recast.synthetic.rendering.ray_scene import Hits, PosedScene
    from recast.synthetic.rendering.surface_points import SurfacePoints


def library() -> ctypes.CDLL | None:
    """The kernel."""
    return kernel.find()


def index_plane(pixels: Int64Array, height: int, width: int) -> NDArray[np.int32]:
    """(H * W,) which of the points at `pixels` (N,) a pixel shows, -1 for none."""
    plane = np.full(height * width, -1, np.int32)
    plane[pixels] = np.arange(len(pixels), dtype=np.int32)
    return plane.reshape(height, width)


def smooth(
    value: Float32Array, guide: Float32Array, steps: Sequence[int], first: Sequence[int]
) -> bool:
    """All passes of `LightFilter.smooth` over (4, H, W), in place."""
    found = library()
    if found is None:
        return False
    passes = np.array(steps, np.int64), np.array(first, np.int64)
    found.recast_smooth(
        address(value), address(guide), *value.shape[1:], *addresses(*passes), len(steps)
    )
    return True


def borrow(
    points: SurfacePoints,
    arriving: tuple[Float32Array, Float32Array],
    index: NDArray[np.int32],
    others: SurfacePoints,
    other_pixels: Int64Array,
    towards: tuple[int, int],
    limits: tuple[np.float32, np.float32],
) -> tuple[Float32Array, Float32Array, Int64Array] | None:
    """`borrow_light`: sun (M,), sky (M, 3), and who found none."""
    found = library()
    if found is None:
        return None
    light, served = np.empty((len(others), 4), np.float32), np.empty(len(others), bool)
    near = points.position, points.normal, *arriving, index
    further = others.position, others.normal, others.distance, other_pixels
    found.recast_borrow(
        *addresses(*near),
        *index.shape,
        *addresses(*further),
        len(others),
        *towards,
        *limits,
        address(light),
        address(served),
    )
    return light[:, 0].copy(), np.ascontiguousarray(light[:, 1:]), np.flatnonzero(~served)


def surface(
    rays: Int64Array,
    origins: Float32Array,
    directions: Float32Array,
    hits: Hits,
    instance: NDArray[np.uint16],
    face: Int64Array,
    posed: PosedScene,
    smooth: bool,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array] | None:
    """`surface_points`: positions, views, flat and shading normals (M, 3)."""
    found = library()
    if found is None:
        return None
    position, view, flat = np.empty((3, len(rays), 3), np.float32)
    normal = np.empty_like(flat) if smooth else flat
    attributes = posed.scene.attributes
    cast = origins, directions, hits.distance, hits.u, hits.v, instance, face
    found.recast_surface(
        address(rays),
        len(rays),
        *addresses(*cast),
        address(attributes.flat_normals),
        address(attributes.corner_normals) if smooth else None,
        *addresses(posed.rotation, position, view, flat, normal),
    )
    return position, view, flat, normal


def edges(
    points: SurfacePoints,
    inverse: Float32Array,
    grey: Float32Array,
    shown: Float32Array,
    index: NDArray[np.int32],
    colour_step: np.float32,
) -> Int64Array | None:
    """`edge_pixels`."""
    found = library()
    if found is None:
        return None
    edge = np.zeros(index.shape, bool)
    looks = points.flat, inverse, grey, shown, points.material, points.instance, index
    found.recast_edges(*addresses(*looks), *index.shape, colour_step, address(edge))
    return np.flatnonzero(edge)


def entered(
    centres: Float32Array, radii: Float32Array, origins: Float32Array, directions: Float32Array
) -> Float32Array | None:
    """`_Spheres.entered`, to rounding."""
    found = library()
    if found is None:
        return None
    entry = np.empty((len(centres), len(origins)), np.float32)
    spheres, rays = (centres, radii), (origins, directions)
    found.recast_entered(
        *addresses(*spheres), len(centres), *addresses(*rays), len(origins), address(entry)
    )
    return entry


def expose(sums: Float32Array, pixels: Int64Array, light: Float32Array, clip: np.float32) -> bool:
    """Adds light (N, 3), no more than `clip`, to the sums (P, 3) of `pixels` (N,)."""
    found = library()
    if found is None:
        return False
    found.recast_expose(*addresses(sums, pixels, light), len(pixels), clip)
    return True


def address(array: NDArray[Any]) -> int:
    """Address of an array's numbers; ValueError for gaps between them and for float64."""
    if not array.flags.c_contiguous:
        raise ValueError(f"compiled: array of shape {array.shape} is not contiguous")
    if array.dtype == np.float64:
        raise ValueError(f"compiled: array of shape {array.shape} is float64, expected float32")
    return array.ctypes.data


def addresses(*arrays: NDArray[Any]) -> list[int]:
    """`address` of each."""
    return [address(array) for array in arrays]
