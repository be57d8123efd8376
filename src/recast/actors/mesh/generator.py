"""A vehicle from a textured mesh instead of a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike

from recast.actors.axes import AUTO, AxisConvention, axes_of
from recast.actors.generate import Asset
from recast.actors.mesh.outside import outside
from recast.actors.mesh.read import read_triangles
from recast.actors.mesh.sample import Samples, sample
from recast.actors.mesh.surfels import surfels
from recast.actors.mesh.triangles import Triangles
from recast.actors.observation import Observation
from recast.actors.template.estimate import road_level
from recast.actors.template.lighting import Daylight
from recast.actors.upright import upright
from recast.errors import InputError
from recast.geometry import se3
from recast.splats import MIP


class MeshGenerator:
    """Takes the triangles of a GLB or OBJ file, in the light that the observation shows.

    Base colour (texture, factor and vertex colours) in daylight as bright as the road around the
    vehicle says; glass stays a layer of its alpha. The surface is sampled on a lattice and merged
    into flat Gaussians, see `sample` and `surfels`.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`; "auto" tells which axis
            points up from the shape and the observed box, see `recast.actors.upright`.
        spacing: metres between the points that the surface is sampled at, once the vehicle is as
            long as the box; larger is coarser and faster.

    Raises:
        InputError: no such convention.
    """

    name = "mesh"

    def __init__(
        self, path: str | Path, axes: str | AxisConvention = AUTO, spacing: float = 0.01
    ) -> None:
        self.path, self.spacing = Path(path), spacing
        self.axes = axes_of(axes) if isinstance(axes, str) and axes != AUTO else axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file; the asset keeps its axes, in metres of the box's length.

        Raises:
            InputError: see `read_triangles`; the mesh is flat; with "auto", no orientation fits
                the box, or the shape does not tell it.
        """
        parts = read_triangles(self.path)
        unit, samples, spacing = sampled(parts, observation.size[0], self.spacing)
        details: dict[str, str | float | int] = {
            "file": self.path.name, "triangles": sum(map(len, parts)),
        }  # fmt: skip
        try:
            seen = outside(samples)
        except ValueError as error:
            raise InputError(self.path, "mesh", str(error), "export it again") from None
        if isinstance(self.axes, AxisConvention):
            axes = self.axes
        else:
            opaque = seen.samples.alpha >= 1
            found = upright(seen.samples.points[opaque], observation.size, self.path)
            axes, details["axes"] = found.axes, f"told from the shape: {found.explain()}"
        turn = axes.rotation()
        standing = replace(
            seen.samples, points=seen.samples.points @ turn.T, normals=seen.samples.normals @ turn.T
        )
        level = road_level(observation)
        made = surfels(replace(seen, samples=standing), Daylight(level, np.full(3, level)))
        extent = " x ".join(f"{side / unit:.4g}" for side in np.ptp(standing.points, axis=0))
        details |= {
            "scale": f"{extent} units, z up; {unit:.4g} m a unit makes it as long as the box",
            "spacing_m": round(spacing, 4),
            "glass_share": round(float((standing.alpha < 1).mean()), 4),
            "light": round(level, 3),
        }
        back = se3.from_rotation_translation(turn.T, np.zeros(3))
        return Asset(made.transformed(torch.from_numpy(back)), axes, self.name, seed, details, MIP)


def sampled(
    parts: Sequence[Triangles], length: ArrayLike, spacing: float
) -> tuple[float, Samples, float]:
    """Metres a unit, samples in metres, and their spacing, of a mesh as long as `length` metres.

    Its longest side along an axis counts as its length; registration finds the exact scale.
    """
    low = np.min([part.corners.min(axis=(0, 1)) for part in parts], axis=0)
    high = np.max([part.corners.max(axis=(0, 1)) for part in parts], axis=0)
    unit = float(length / max((high - low).max(), 1e-9))
    centre = (low + high) / 2
    metric = [replace(part, corners=(part.corners - centre) * unit) for part in parts]
    return unit, *sample(metric, spacing)
