"""A clean vehicle with the faults of image-to-3D assets: floaters, dark insides, any heading in a
unit cube, light baked in from one side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from recast.actors import Asset
from recast.actors.generate import UNIT_CUBE_Z_UP
from recast.actors.icp import outer_surface
from recast.geometry import se3
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import C0

WHITE = 0.95  # display value of floaters: no part of a red or dark car has it


def blobs(points: np.ndarray, value: float, width: float) -> Gaussians:
    """Round opaque Gaussians at points (N, 3) of one grey display value."""
    count = len(points)
    return Gaussians(
        means=torch.as_tensor(points, dtype=torch.float32),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        log_scales=torch.full((count, 3), float(np.log(width))),
        logit_opacities=torch.full((count,), 4.0),
        sh=torch.full((count, 1, 3), (value - 0.5) / C0),
    )


def floaters(size: np.ndarray, seed: int = 0, clusters: int = 12, each: int = 25) -> Gaussians:
    """White clusters beside and above a vehicle of `size`, 0.4 to 0.8 of its length from its
    middle."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(0, 2 * np.pi, clusters)
    reach = size[0] * rng.uniform(0.62, 0.8, clusters)
    height = size[2] * rng.uniform(-0.3, 1.0, clusters)
    centres = np.stack([reach * np.cos(azimuth), reach * np.sin(azimuth), height], axis=-1)
    points = np.repeat(centres, each, axis=0) + rng.normal(0, 0.04, (clusters * each, 3))
    return blobs(points, WHITE, 0.04)


def dark_inside(gaussians: Gaussians, seed: int = 0, count: int = 4000) -> Gaussians:
    """Opaque black Gaussians within the shell, up to 0.85 of the way from the middle to it."""
    rng = np.random.default_rng(seed)
    points = outer_surface(gaussians).points
    chosen = points[rng.integers(len(points), size=count)]
    return blobs(chosen * rng.uniform(0.3, 0.85, (count, 1)), 0.0, 0.05)


def lit_from_left(gaussians: Gaussians, normals: Tensor, strength: float = 0.45) -> Gaussians:
    """Colours up to `strength` brighter where the surface (N, 3) faces left, darker elsewhere."""
    factor = 1 + strength * normals[:, 1]
    sh = gaussians.sh.clone()
    sh[:, 0] = ((0.5 + C0 * sh[:, 0]).clamp(0, 1) * factor[:, None] - 0.5) / C0
    return replace(gaussians, sh=sh)


def in_cube(gaussians: Gaussians, heading: float) -> Asset:
    """The vehicle in a cube of edge 1, z up, turned by `heading`; no front is declared."""
    turn = se3.from_rotation_translation(se3.rotation_z(heading), np.zeros(3))
    edge = float((gaussians.means.amax(dim=0) - gaussians.means.amin(dim=0)).max())
    cube = gaussians.transformed(torch.from_numpy(turn), 1 / edge)
    return Asset(cube, UNIT_CUBE_Z_UP, "made up", 0)


def together(*parts: Gaussians) -> Gaussians:
    """All parts as one cloud."""
    return concatenate(list(parts))
