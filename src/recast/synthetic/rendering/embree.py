"""Ray queries against one triangle mesh, through the optional package embreex (Embree 4)."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.synthetic.surface import Surface

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

NO_HIT = np.float32(1e37)
"""Embree's distance of a ray that met nothing."""


class MeshHits(NamedTuple):
    """First hits on one mesh: distance (N,) in ray lengths, `NO_HIT` where none; face; u, v."""

    distance: Float32Array
    face: NDArray[np.int32]
    u: Float32Array
    v: Float32Array


class Mesh:
    """The bounding volume hierarchy of one surface, in the surface's own frame.

    Args:
        surface: may be empty: then nothing is ever hit.

    Raises:
        InputError: embreex is not installed.
    """

    def __init__(self, surface: Surface) -> None:
        rtcore_scene, mesh_construction = _embreex()
        triangles = surface.vertices[surface.faces].astype(np.float32)
        self._scene: Any = None
        if len(triangles):
            self._scene = rtcore_scene.EmbreeScene()
            self._geometry = mesh_construction.TriangleMesh(self._scene, triangles)
            # The hierarchy is built by the first query; a worker forked later then shares it.
            self.occluded(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def first_hits(
        self, origins: Float32Array, directions: Float32Array, limit: Float32Array | None = None
    ) -> MeshHits:
        """Nearest hits of rays (N, 3), (N, 3), nearer than `limit` (N,) where given."""
        count = len(origins)
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
        self, origins: Float32Array, directions: Float32Array, limit: Float32Array | None = None
    ) -> BoolArray:
        """Whether rays (N, 3), (N, 3) meet anything, within `limit` (N,) where given."""
        if self._scene is None or not len(origins):
            return np.zeros(len(origins), bool)
        far = None if limit is None else limit.astype(np.float32)
        hit: BoolArray = self._scene.run(origins, directions, dists=far, query="OCCLUDED") >= 0
        return hit


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
