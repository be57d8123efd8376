"""Vehicles of the user's instead of a network's: PLY, GLB and OBJ files, and folders of actors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.actors.axes import AUTO, VEHICLE, AxisConvention, axes_of, upright
from recast.actors.generate import ActorGenerator, Asset
from recast.actors.icp import outer_surface
from recast.actors.mesh import MESH_SUFFIXES, MeshGenerator, files_of_mesh
from recast.actors.observation import Observation
from recast.actors.store import ACTOR_FILE, load_actor
from recast.core.errors import InputError
from recast.splats import CLASSIC, MIP, Gaussians, LowPass, read_ply
from recast.splats.ply import read_low_pass

# Of the published decoder of TRELLIS, in unit cubes (rounded up by what float32 and text lose).
_PER_VOXEL, _LARGEST_SPREAD, _LEAST_DEVIATION = 32, 1.5 / 64 + 1e-5, 9e-4
_PLY = ".ply"
VEHICLE_SUFFIXES = (_PLY, *MESH_SUFFIXES)
"""Ends of the names of files that hold a vehicle, in lower case."""


class PlyGenerator:
    """Takes the Gaussians of a PLY file (INRIA layout) whatever the observation shows.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`; "auto" tells which axis
            points up from the shape and the observed box, see `recast.actors.axes.upright`.
        low_pass: the filter that it was made for. None takes what the file declares
            (`recast.splats.write_ply`); if it declares none, that of TRELLIS for what its published
            decoder made (`made_by_trellis`), else that of 3DGS.

    Raises:
        InputError: no such convention.
    """

    name = "ply"

    def __init__(
        self, path: str | Path, axes: str | AxisConvention = AUTO, low_pass: LowPass | None = None
    ) -> None:
        self.path, self.low_pass = Path(path), low_pass
        self.axes = axes_of(axes) if isinstance(axes, str) and axes != AUTO else axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file.

        Raises:
            InputError: the file is missing, lacks a field, or holds a value that is not finite;
                with "auto", no orientation fits the box, or the shape does not tell it.
        """
        gaussians = read_ply(self.path)
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
            axes, details["axes"] = found.axes, f"told from the shape: {found.explain()}"
        low_pass = self.low_pass or read_low_pass(self.path)
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


def is_vehicle_file(name: str | Path) -> bool:
    """Whether the name is that of a PLY, GLB or OBJ; the file need not exist."""
    return str(name).lower().endswith(VEHICLE_SUFFIXES)


def is_actor_folder(path: Path) -> bool:
    """Whether it is a folder that `save_actor` wrote."""
    return (path / ACTOR_FILE).is_file()


def vehicle_generator(
    path: str | Path, axes: str = AUTO, spacing: float | None = None
) -> ActorGenerator:
    """What takes the vehicle of a file or of an actor's folder.

    Args:
        axes: orientation of a file, see `recast.actors.axes_of`; an actor knows its own.
        spacing: metres between the points of a mesh; its own if None.

    Raises:
        InputError: no such file, or no such axes.
    """
    path = Path(path)
    if is_actor_folder(path):
        return ActorFolderGenerator(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", "check the path given as --generator")
    if path.suffix.lower() == _PLY:
        return PlyGenerator(path, axes)
    return MeshGenerator(path, axes) if spacing is None else MeshGenerator(path, axes, spacing)


def files_of_vehicle(path: Path) -> list[Path]:
    """The file and all others that it names.

    Raises:
        InputError: see `files_of_mesh`.
    """
    return [path] if path.suffix.lower() == _PLY else files_of_mesh(path)


class ActorFolderGenerator:
    """Takes the vehicle of an actor that was made for another track.

    Args:
        path: the folder.
    """

    name = "actor"

    def __init__(self, path: Path) -> None:
        self.path = path

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the folder; the vehicle keeps its size.

        Raises:
            InputError: see `load_actor`.
        """
        actor = load_actor(self.path)
        details = {"file": self.path.name, "made_by": actor.provenance.generator}
        return Asset(actor.gaussians, VEHICLE, self.name, seed, details, actor.low_pass)
