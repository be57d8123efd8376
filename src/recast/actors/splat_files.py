"""Vehicles in files of Gaussians, in the place of a generator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.actors.axes import AUTO, AxisConvention, axes_of, upright
from recast.actors.generate import Asset, BaseGenerator
from recast.actors.icp import outer_surface
from recast.actors.observation import Observation
from recast.core.errors import InputError
from recast.splats import CLASSIC, MIP, Gaussians, LowPass
from recast.splats.formats import GLTF, format_of, has_gaussians, splat_suffixes

# Of the published decoder of TRELLIS, in unit cubes (rounded up by what float32 and text lose).
_PER_VOXEL, _LARGEST_SPREAD, _LEAST_DEVIATION = 32, 1.5 / 64 + 1e-5, 9e-4


def holds_gaussians(path: Path) -> bool:
    """Whether a vehicle file holds Gaussians, not a mesh; of a GLB its content tells.

    Raises:
        InputError: a GLB cannot be opened.
    """
    suffix = path.suffix.lower()
    return has_gaussians(path) if suffix == GLTF.suffix else suffix in splat_suffixes()


class SplatGenerator(BaseGenerator):
    """Takes the Gaussians of a PLY, glTF, SPZ or OpenUSD file whatever the observation shows.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`, of the axes that the file
            itself has (OpenUSD: with z up); "auto" tells which axis points up from the shape and
            the observed box, see `recast.actors.axes.upright`.
        low_pass: the filter that it was made for. None takes what the file declares
            (`recast.splats.formats`); if it declares none, that of TRELLIS for what its published
            decoder made (`made_by_trellis`), else that of 3DGS.

    Raises:
        InputError: no such convention, or no such format.
    """

    def __init__(
        self, path: str | Path, axes: str | AxisConvention = AUTO, low_pass: LowPass | None = None
    ) -> None:
        self.path, self.low_pass = Path(path), low_pass
        self.format = format_of(path)
        self.name: str = self.format.name
        self.axes = axes_of(axes) if isinstance(axes, str) and axes != AUTO else axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file.

        Raises:
            InputError: the file is missing, lacks a field, or holds a value that is not finite;
                with "auto", no orientation fits the box, or the shape does not tell it.
        """
        gaussians = self.format.read(self.path)
        if len(gaussians) == 0:
            raise InputError(self.path, "vertex", "holds no Gaussians", "export the asset again")
        details: dict[str, str | float | int] = {"file": self.path.name}
        if isinstance(self.axes, AxisConvention):
            axes = self.axes
        else:
            try:
                points = outer_surface(gaussians).points
            except ValueError as error:
                mend = "export the asset again"
                raise InputError(self.path, "shape", str(error), mend) from None
            found = upright(points, observation.size, self.path)
            axes, details["axes"] = found.axes, f"inferred from the shape: {found.explain()}"
        low_pass = self.low_pass or self.format.low_pass(self.path)
        if low_pass is None:
            low_pass = MIP if made_by_trellis(gaussians) else CLASSIC
        return Asset(gaussians, axes, self.name, seed, details, low_pass)


def made_by_trellis(gaussians: Gaussians) -> bool:
    """Whether these are, row by row, what the published decoder of TRELLIS gives.

    32 Gaussians for each voxel of 1/64, within three quarters of a voxel of its centre; no
    harmonics; no deviation below 9e-4.
    """
    if gaussians.sh_degree > 0 or len(gaussians) == 0 or len(gaussians) % _PER_VOXEL:
        return False
    voxels = gaussians.means.reshape(-1, _PER_VOXEL, 3)
    spread = float((voxels.amax(dim=1) - voxels.amin(dim=1)).max())
    least = float(gaussians.log_scales.min())
    return spread <= _LARGEST_SPREAD and least >= np.log(_LEAST_DEVIATION) - 1e-4
