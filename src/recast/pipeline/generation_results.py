"""What makes the vehicles of a row of a generation study, and results that were made elsewhere.

    NAME=WHAT          a model folder, a generator, a PLY, GLB or OBJ, library:FOLDER
    NAME=files:DIR     DIR/ID.ply, .glb or .obj, made elsewhere from the same inputs
    NAME=views:DIR     DIR/ID/VIEW.png, a picture of each target view, drawn elsewhere

On perturbed inputs, the last two are looked for in DIR/perturbed. Inputs and target views come from
`recast.pipeline.generation_inputs`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from recast.actors.axes import AUTO
from recast.actors.library import LIBRARY
from recast.actors.vehicle_files import VEHICLE_SUFFIXES
from recast.core.hashing import file_hash, files_hash
from recast.errors import InputError
from recast.evaluation.actor_cases import ActorCase
from recast.names import folder_name
from recast.pipeline.sources import generator_source
from recast.recar.picture import Image, read_picture

FILES, VIEWS = "files:", "views:"
"""What sources of results by vehicle begin with."""
CLEAN, PERTURBED = "clean", "perturbed"
"""Conditions; the second is also the folder of results on perturbed inputs."""


@dataclass(frozen=True)
class StudyModel:
    """What makes the vehicles of a row.

    Attributes:
        source: see the module.
        axes: orientation of files and models, see `recast.actors.axes_of`.
    """

    source: str
    axes: str = AUTO

    @property
    def folder(self) -> Path | None:
        """Of results by vehicle; None for what runs here."""
        if self.source.startswith((FILES, VIEWS)):
            return Path(self.source.partition(":")[2])
        return None

    @property
    def label(self) -> str:
        """The source without the folders around it."""
        prefix = next((p for p in (FILES, VIEWS, LIBRARY) if self.source.startswith(p)), "")
        return prefix + Path(self.source.removeprefix(prefix)).name

    def on(self, condition: str) -> StudyModel:
        """The model for inputs of a condition."""
        if self.folder is None or condition == CLEAN:
            return self
        return replace(self, source=f"{self.source}/{PERTURBED}")


def vehicle_hash(model: StudyModel, case: ActorCase) -> str:
    """Of the results of one vehicle; empty where there are none."""
    assert model.folder is not None
    if model.source.startswith(FILES):
        files = [path for path in _vehicle_files(model.folder, case.id) if path.is_file()]
        return " ".join([*map(_file_source, files), model.axes]) if files else ""
    paths = [path for path in view_paths(model.folder, case) if path.is_file()]
    return files_hash(paths, model.folder) if paths else ""


def _file_source(path: Path) -> str:
    try:
        return generator_source(str(path))
    except InputError:  # of a broken mesh: that vehicle fails, not the study
        return file_hash(path)


def _vehicle_files(folder: Path, id: str) -> list[Path]:
    return [folder / f"{folder_name(id)}{suffix}" for suffix in VEHICLE_SUFFIXES]


def vehicle_file(folder: Path, id: str) -> Path:
    """The file of a vehicle.

    Raises:
        InputError: none, or several.
    """
    found = [path for path in _vehicle_files(folder, id) if path.is_file()]
    if len(found) != 1:
        many = f"{len(found)} files: " + ", ".join(path.name for path in found)
        problem = many if found else "no file of this vehicle"
        raise InputError(folder, id, f"has {problem}", "one PLY, GLB or OBJ is wanted")
    return found[0]


def view_paths(folder: Path, case: ActorCase) -> list[Path]:
    """Where the pictures of a vehicle's target views lie, in the order of the targets."""
    return [folder / folder_name(case.id) / view_name(view.name) for view in case.targets]


def view_name(view: str) -> str:
    """File name of the picture of a view."""
    return f"{folder_name(view)}.png"


def read_views(folder: Path, case: ActorCase) -> list[Image]:
    """The pictures of a vehicle's target views, each (H, W, 4) uint8 with straight alpha.

    Raises:
        InputError: one is missing, broken, of another size than the target, or has no alpha.
    """
    paths = view_paths(folder, case)
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        raise InputError(
            folder / folder_name(case.id), "views",
            f"{len(missing)} of {len(paths)} are missing, such as {missing[0]}",
            "draw every target view that `recast eval inputs` lists",
        )  # fmt: skip
    pictures = []
    for path, view in zip(paths, case.targets, strict=True):
        try:
            pictures.append(read_picture(path, view.camera.width, view.camera.height))
        except InputError as error:
            mend = "draw the vehicle as 8-bit RGBA in the size of the target view"
            raise InputError(error.where, error.field, error.problem, mend) from None
    return pictures
