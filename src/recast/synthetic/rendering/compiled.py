"""Arithmetic of frames in the compiled kernel, where there is one: numpy's bits, sooner.

Every function here says, by None or False, that nothing is compiled; its caller then computes the
same in numpy, which is the reference. csrc/frames.cpp holds the other side.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, files
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast import kernel
from recast.arrays import BoolArray, Float32Array, Int64Array

if TYPE_CHECKING:
    from recast.synthetic.rendering.rays import Hits, PosedScene
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


# Embree's C interface, of the copy that embreex carries: rays in packets instead of one by one.
#
# Embreex casts single rays. Packets of rays that lie close together take a quarter of the time;
# they need the compiled kernel, and embree's library as a file of the installed embreex.

_MAJOR = 4
_VERSION, _NATIVE_WIDTHS = 0, {16: 34, 8: 33, 4: 32}  # RTC_DEVICE_PROPERTY_...
_TRIANGLES, _INDICES, _VERTICES, _FLOAT3, _UINT3 = 0, 0, 1, 0x9003, 0x5003
_POINTER, _INT, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.c_size_t
_SIGNATURES = {
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, [_POINTER, _INT]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcNewGeometry": (_POINTER, [_POINTER, _INT]),
    "rtcSetNewGeometryBuffer": (_POINTER, [_POINTER, _INT, _UINT, _INT, _SIZE, _SIZE]),
    "rtcCommitGeometry": (None, [_POINTER]),
    "rtcAttachGeometry": (_UINT, [_POINTER, _POINTER]),
    "rtcReleaseGeometry": (None, [_POINTER]),
    "rtcCommitScene": (None, [_POINTER]),
    "rtcReleaseScene": (None, [_POINTER]),
}


class _Embree(NamedTuple):
    """The library, a device of one thread, and how to ask for packets of the machine's width."""

    calls: ctypes.CDLL
    device: int
    width: int
    intersect: int
    occluded: int


@lru_cache(maxsize=1)
def _embree() -> _Embree | None:
    """Embree; None where it is not found, or is of another version."""
    try:
        carried = files("embreex") or []
    except PackageNotFoundError:
        return None
    for path in carried:
        if "embree4" not in path.name:
            continue
        calls = ctypes.CDLL(str(path.locate()))
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(calls, name)
            function.restype, function.argtypes = result, arguments
        device = calls.rtcNewDevice(b"threads=1")
        if not device or calls.rtcGetDeviceProperty(device, _VERSION) // 10_000 != _MAJOR:
            return None
        for width, native in _NATIVE_WIDTHS.items():
            if calls.rtcGetDeviceProperty(device, native):
                queries = (f"rtcIntersect{width}", f"rtcOccluded{width}")
                places = [ctypes.cast(getattr(calls, name), _POINTER).value for name in queries]
                return _Embree(calls, device, width, *(place or 0 for place in places))
    return None


def packets_work() -> bool:
    """Whether `PacketScene` can be used here."""
    return library() is not None and _embree() is not None


class PacketScene:
    """The hierarchy of some triangles.

    Args:
        triangles: (F, 3, 3) float32, at least one.

    Raises:
        RuntimeError: `packets_work` says no.
    """

    def __init__(self, triangles: Float32Array) -> None:
        embree, kernel = _embree(), library()
        if embree is None or kernel is None:
            raise RuntimeError("PacketScene: needs the compiled kernel and embree's library")
        self._embree, self._kernel = embree, kernel
        calls, count = embree.calls, len(triangles)
        geometry = calls.rtcNewGeometry(embree.device, _TRIANGLES)
        corners = np.ascontiguousarray(triangles, np.float32)
        indices = np.arange(3 * count, dtype=np.uint32)
        for kind, kind_format, numbers, items in (
            (_VERTICES, _FLOAT3, corners, 3 * count),
            (_INDICES, _UINT3, indices, count),
        ):
            # Embree reads a little beyond the end: its own buffers have room for that.
            place = calls.rtcSetNewGeometryBuffer(geometry, kind, 0, kind_format, 12, items)
            ctypes.memmove(place, address(numbers), numbers.nbytes)
        calls.rtcCommitGeometry(geometry)
        self._scene = calls.rtcNewScene(embree.device)
        calls.rtcAttachGeometry(self._scene, geometry)
        calls.rtcReleaseGeometry(geometry)
        calls.rtcCommitScene(self._scene)
        weakref.finalize(self, calls.rtcReleaseScene, self._scene)

    def first_hits(
        self,
        origins: Float32Array,
        directions: Float32Array,
        limit: Float32Array | None,
        coherent: bool,
    ) -> tuple[Float32Array, NDArray[np.int32], Float32Array, Float32Array]:
        """Distance, face, u and v (N,) of rays (N, 3), (N, 3)."""
        distance, u, v = np.empty((3, len(origins)), np.float32)
        face = np.empty(len(origins), np.int32)
        self._kernel.recast_first_hits(
            self._embree.intersect,
            self._embree.width,
            self._scene,
            *_rays(origins, directions),
            None if limit is None else address(limit),
            len(origins),
            coherent,
            *addresses(distance, face, u, v),
        )
        return distance, face, u, v

    def occluded(
        self, origins: Float32Array, directions: Float32Array, coherent: bool
    ) -> BoolArray:
        """Whether rays (N, 3), (N, 3) meet anything."""
        blocked = np.empty(len(origins), bool)
        self._kernel.recast_occluded(
            self._embree.occluded,
            self._embree.width,
            self._scene,
            *_rays(origins, directions),
            len(origins),
            coherent,
            address(blocked),
        )
        return blocked


def _rays(origins: Float32Array, directions: Float32Array) -> tuple[int, int]:
    for name, array in (("origins", origins), ("directions", directions)):
        if array.dtype != np.float32 or array.shape != (len(origins), 3):
            raise ValueError(f"{name}: expected (N, 3) float32, got {array.shape} {array.dtype}")
    return address(origins), address(directions)
