"""A vehicle from a textured mesh instead of a network: read, sampled, and made flat Gaussians.

Few Gaussians where nothing changes, many where colours do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.special import spence

from recast.actors.axes import AUTO, AxisConvention, axes_of, upright
from recast.actors.generate import Asset, BaseGenerator
from recast.actors.mesh.gltf import files_of_glb, read_glb
from recast.actors.mesh.obj import files_of_obj, read_obj
from recast.actors.mesh.sample import Outside, Samples, outside, sample
from recast.actors.mesh.triangles import Triangles
from recast.actors.observation import Observation
from recast.actors.template.cloud import (
    COVERAGE,
    flat_gaussians,
    group_means,
    group_patches,
    shell_groups,
    tangents,
)
from recast.actors.template.lighting import Daylight, fit_harmonics, road_level
from recast.arrays import Int64Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.splats import MIP, Gaussians
from recast.splats.gaussians import concatenate
from recast.splats.sh import C0

_GLTF = (read_glb, files_of_glb)
_READERS = {".glb": _GLTF, ".gltf": _GLTF, ".obj": (read_obj, files_of_obj)}
MESH_SUFFIXES = tuple(_READERS)
"""Ends of the names of files that can be read, in lower case."""
MOST_GAUSSIANS = 120_000
"""Number of Gaussians of a surface, if merging can reach it: a rollout pays for each."""
_OPACITY = 0.99
_OPACITIES = np.linspace(0.001, _OPACITY, 1000)
_TAKEN = spence(1 - _OPACITIES)  # the dilogarithm Li2 of them
_CELLS = (0.04, 0.02)  # metres: points that look alike are merged in voxels of these edges
_TOLERANCES = (0.03, 0.06, 0.12, 0.25, 0.5)  # display values
_SHELL_CELL = 0.10  # metres
_SHELL_DEPTHS = (0.04, 0.10)  # metres behind the surface: a layer of its colour, and a dark one
_MARGIN, _NEAR = 0.13, 0.065  # metres: so far beside a wide Gaussian, the surface is so near
_DARK = 0.06  # display value of a cabin without light


def read_triangles(path: Path) -> list[Triangles]:
    """The triangles of a mesh file, in its frame and unit.

    Raises:
        InputError: see `read_glb` and `read_obj`; or a file of another kind.
    """
    return _readers(path)[0](path)


def files_of_mesh(path: Path) -> list[Path]:
    """The file and all that it names: material libraries, textures, buffers.

    Raises:
        InputError: see `read_triangles`.
    """
    return [path, *_readers(path)[1](path)]


def _readers(path: Path) -> tuple:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(MESH_SUFFIXES)
        raise InputError(path, "format", f"{suffix!r} is unknown", f"use {known}")
    return _READERS[suffix]


class MeshGenerator(BaseGenerator):
    """Takes the triangles of a glTF or OBJ file, in the light that the observation shows.

    Base colour (texture, factor and vertex colours) in daylight as bright as the road around the
    vehicle says, and what the surface emits; unlit materials keep their colour. Glass stays a layer
    of its alpha. The surface is sampled on a lattice and merged
    into flat Gaussians, see `sample` and `surfels`.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`; "auto" tells which axis
            points up from the shape and the observed box, see `recast.actors.axes.upright`.
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
            "file": self.path.name,
            "triangles": sum(map(len, parts)),
        }
        try:
            seen = outside(samples)
        except ValueError as error:
            raise InputError(self.path, "mesh", str(error), "export the mesh again") from None
        if isinstance(self.axes, AxisConvention):
            axes = self.axes
        else:
            opaque = seen.samples.alpha >= 1
            found = upright(seen.samples.points[opaque], observation.size, self.path)
            axes, details["axes"] = found.axes, f"inferred from the shape: {found.explain()}"
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


def surfels(vehicle: Outside, light: Daylight) -> Gaussians:
    """Flat Gaussians of samples in metres, z up, in daylight.

    Samples of a voxel that look alike become one Gaussian, as wide as they are together
    (`template.merge.flat_gaussians`); light is baked as into a template (`template.lighting`).
    Squares of edge e side by side, each a Gaussian of deviation c e / sqrt(12), overlap
    n = 2 pi c^2 / 12 times. A Gaussian of opacity o takes n Li2(o) from the logarithm of what a
    square lets through (the integral of -log(1 - o exp(-r^2 / 2)) is 2 pi Li2(o)), so that for
    glass o solves n Li2(o) = -log(1 - alpha).
    """
    samples = vehicle.samples
    group = _groups(samples)
    floor = float(samples.points[:, 2].min())
    surface = _lit(samples, group, floor, light)
    (alpha,) = group_means(group, samples.alpha)
    alone, merged = COVERAGE
    overlap = np.pi / 6 * np.where(np.bincount(group) > 1, merged, alone) ** 2
    taken = -np.log(1 - np.minimum(alpha, _OPACITY)) / overlap
    opacity = np.where(alpha < 1, np.interp(taken, _TAKEN, _OPACITIES), _OPACITY)
    logits = torch.from_numpy(np.log(opacity / (1 - opacity))).float()
    parts = [replace(surface, logit_opacities=logits)]
    if vehicle.closed.any():
        parts += _shells(samples.select(vehicle.closed), floor, light, bool((alpha < 1).any()))
    return concatenate(parts)


def _groups(samples: Samples) -> Int64Array:
    """(N,) the Gaussian of each sample; what is less alike is merged if there are too many."""
    colours = (linear_to_gamma(samples.albedo), linear_to_gamma(samples.emission))
    look = np.c_[(*colours, 0.1 * samples.gloss, samples.alpha)]
    for tolerance in _TOLERANCES:
        group = group_patches(samples.points, samples.normals, look, _CELLS, tolerance)
        if int(group.max()) < MOST_GAUSSIANS:
            break
    return group


def _lit(samples: Samples, group: Int64Array, floor: float, light: Daylight) -> Gaussians:
    """One opaque Gaussian a group, in daylight; what it emits is added to its constant colour."""
    points, normals, albedo, gloss, emission = group_means(
        group, samples.points, samples.normals, samples.albedo, samples.gloss, samples.emission
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    sh = fit_harmonics(albedo, gloss, normals, points[:, 2] - floor, light)
    bright = emission.any(axis=1)
    reflected = gamma_to_linear(np.clip(C0 * sh[bright, 0] + 0.5, 0.0, None))
    sh[bright, 0] = (linear_to_gamma(reflected + emission[bright]) - 0.5) / C0
    return flat_gaussians(group, samples.points, samples.normals, samples.spacing, sh, _OPACITY)


def _shells(closed: Samples, floor: float, light: Daylight, windows: bool) -> list[Gaussians]:
    """Coarse sheets behind the surface.

    The first has its colour and closes its gaps. The second is dark: through windows, one does not
    see the paint of the far side from within. Cells near an edge or of several colours have none,
    or they would show in openings and around wheels.
    """
    group = shell_groups(closed.points, closed.normals, _SHELL_CELL)
    look = linear_to_gamma(closed.albedo + closed.emission)
    centres, normals, mean, square = group_means(
        group, closed.points, closed.normals, look, look**2
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inner = (square - mean**2).max(axis=1) < _TOLERANCES[0] ** 2
    tree = cKDTree(closed.points)
    behind = centres - _SHELL_DEPTHS[0] * normals
    for way in tangents(normals):
        for sign in (-1, 1):
            beside = behind + sign * _MARGIN * way
            distance, nearest = tree.query(beside)
            above = np.sum((beside - closed.points[nearest]) * closed.normals[nearest], axis=1)
            inner &= (distance < _NEAR) & (above < 0)
    if not inner.any():
        return []
    kept = closed.select(inner[group])
    group = np.unique(group[inner[group]], return_inverse=True)[1]
    (inwards,) = group_means(group, -kept.normals)
    sheet = _lit(kept, group, floor, light)
    step = torch.from_numpy(inwards).float()
    near, far = (replace(sheet, means=sheet.means + depth * step) for depth in _SHELL_DEPTHS)
    dark = torch.zeros_like(far.sh)
    dark[:, 0] = (_DARK - 0.5) / C0
    return [near, replace(far, sh=dark)] if windows else [near]
