"""A vehicle from a file instead of a network."""

from __future__ import annotations

from pathlib import Path

from recast.actors.axes import CONVENTIONS, AxisConvention
from recast.actors.generate import Asset
from recast.actors.observation import Observation
from recast.errors import InputError
from recast.splats import read_ply


class PlyGenerator:
    """Takes the Gaussians of a PLY file (INRIA layout) whatever the observation shows.

    Args:
        path: the file.
        axes: its axis convention, by name (`axes.CONVENTIONS`) or as such.

    Raises:
        InputError: no such convention.
    """

    name = "ply"

    def __init__(self, path: str | Path, axes: str | AxisConvention = "unit_cube_z_up") -> None:
        self.path = Path(path)
        if isinstance(axes, str):
            if axes not in CONVENTIONS:
                raise InputError(
                    path, f"axes {axes}", "is no known convention",
                    "choose one of: " + ", ".join(CONVENTIONS),
                )  # fmt: skip
            axes = CONVENTIONS[axes]
        self.axes = axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file.

        Raises:
            InputError: the file is missing, lacks a field, or holds a value that is not finite.
        """
        del observation  # the file is what it is
        gaussians = read_ply(self.path)
        if len(gaussians) == 0:
            raise InputError(self.path, "vertex", "holds no Gaussians", "export the asset again")
        return Asset(gaussians, self.axes, self.name, seed, {"file": self.path.name})
