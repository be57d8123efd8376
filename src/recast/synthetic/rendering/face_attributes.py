"""Attributes of all faces of a scene in one table, so that one look-up serves all instances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np

from recast.synthetic.surface import Surface


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
        flat = []
        for surface in surfaces:
            corners = surface.vertices[surface.faces]
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            length = np.linalg.norm(cross, axis=1, keepdims=True)
            flat.append((cross / np.maximum(length, 1e-20)).astype(np.float32))
        self.flat_normals = np.concatenate(flat)

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
