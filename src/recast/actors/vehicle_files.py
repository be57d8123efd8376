"""Vehicles of the user's: PLY, GLB and OBJ files, and folders of actors."""

from __future__ import annotations

from pathlib import Path

from recast.actors.axes import AUTO, VEHICLE
from recast.actors.generate import ActorGenerator, Asset
from recast.actors.mesh import MESH_SUFFIXES, MeshGenerator, files_of_mesh
from recast.actors.observation import Observation
from recast.actors.ply_generator import PlyGenerator
from recast.actors.store import ACTOR_FILE, load_actor
from recast.errors import InputError

_PLY = ".ply"
VEHICLE_SUFFIXES = (_PLY, *MESH_SUFFIXES)
"""Ends of the names of files that hold a vehicle, in lower case."""


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
