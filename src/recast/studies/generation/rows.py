"""What makes the vehicles of a generation study's rows, on the command line and in a study file.

docs/recar.md lists what a row may name. Results on perturbed inputs lie in DIR/perturbed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from recast.actors import make_generator
from recast.actors.generate import AUTO
from recast.actors.library import LIBRARY, LibraryGenerator
from recast.actors.vehicle_files import VEHICLE_SUFFIXES, is_vehicle_file
from recast.arrays import Image
from recast.core.artefact import file_hash, files_hash, value_hash
from recast.core.errors import InputError
from recast.core.files import folder_name
from recast.core.records import Record, read_record
from recast.metrics.actor_scores import ActorCase, Targets
from recast.recar.perturb import PerturbationConfig
from recast.recar.views import Text, read_picture
from recast.runs.sources import generator_source
from recast.trellis import verify_checkpoint

FILES, VIEWS = "files:", "views:"
"""What sources of results by vehicle begin with."""
CLEAN, PERTURBED = "clean", "perturbed"
"""Conditions; the second is also the folder of results on perturbed inputs."""
ROWS_FORMAT = "recast-generation-rows"
ROWS_VERSION = 1
PAPER_COLUMNS = ("psnr", "ssim", "lpips", "clip", "fd_inception", "fd_dino")
"""Scores in the paper's order, keys of `STUDY_COLUMNS`."""
_ROWS = {
    "Real3D": (13.19, 0.5691, 0.3223, 68.17, 91.196, 1282.01),
    "LN3Diff": (18.95, 0.8843, 0.1105, 63.03, 93.288, 1455.05),
    "3DTopia-XL": (15.54, 0.8085, 0.1817, 59.90, 166.294, 1299.59),
    "SAR3D": (15.39, 0.8231, 0.1588, 66.55, 64.042, 746.99),
    "Asset Harvester": (19.22, 0.8792, 0.1044, 78.29, 38.368, 183.08),
    "TRELLIS": (21.02, 0.9077, 0.0603, 78.22, 9.788, 43.89),
    "Stage I only": (22.90, 0.9178, 0.0534, 78.30, 8.176, 36.94),
    "both stages": (22.90, 0.9179, 0.0532, 78.38, 7.992, 36.47),
}
PAPER_ROWS: Mapping[str, Mapping[str, float]] = {
    row: dict(zip(PAPER_COLUMNS, values, strict=True)) for row, values in _ROWS.items()
}
"""The paper's scores (RECAST, section 5, Q3) by row and key of `STUDY_COLUMNS`; the last
three are the ablation. They are of its held-out RECAR vehicles and the published weights: on other
sets they say what to expect of the order, not of the values."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")
_MOST_ROWS = 64
_MEND = "correct the study file; see docs/recar.md#judging-a-model"


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
        """Folder of results by vehicle; None for what runs here."""
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
    """Hash of the results of one vehicle; empty where there are none."""
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
        mend = f"give one file with a suffix of {', '.join(VEHICLE_SUFFIXES)}"
        raise InputError(folder, id, f"has {problem}", mend)
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
            folder / folder_name(case.id),
            "views",
            f"{len(missing)} of {len(paths)} are missing, such as {missing[0]}",
            "draw every target view that `recast eval inputs` lists",
        )
    pictures = []
    for path, view in zip(paths, case.targets, strict=True):
        try:
            pictures.append(read_picture(path, view.camera.width, view.camera.height))
        except InputError as error:
            mend = "draw the vehicle as 8-bit RGBA in the size of the target view"
            raise InputError(error.where, error.field, error.problem, mend) from None
    return pictures


def _check_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(
            "use at most 40 letters, digits, '.', '_' and '-'; begin with a letter or digit"
        )
    return name


def _check_published(row: str | None) -> str | None:
    if row is not None and row not in PAPER_ROWS:
        raise ValueError(f"is not one of {', '.join(PAPER_ROWS)}")
    return row


class RowRecord(Record):
    """A row in a study file.

    Attributes:
        source: source of the row's vehicles, paths from the study file's folder; None if the row is
            not run.
        axes: orientation of files and models, see `recast.actors.axes_of`.
        published: row of the paper whose figures stand beside it.
    """

    name: Annotated[str, AfterValidator(_check_name)]
    source: Text | None
    axes: Text = AUTO
    published: Annotated[str | None, AfterValidator(_check_published)] = None


class StudyRecord(Record):
    """Contents of a study file: what inputs depend on, and the rows.

    Attributes:
        seed: seed of everything random, the choice of the input views too.
        perturbations: perturbations of the perturbed inputs; None where all inputs are clean.
    """

    format: Literal["recast-generation-rows"] = "recast-generation-rows"
    version: int = ROWS_VERSION
    seed: int = Field(default=0, ge=0, lt=2**63)
    targets: Targets = "set"
    perturbations: PerturbationConfig | None = None
    rows: tuple[RowRecord, ...] = Field(min_length=1, max_length=_MOST_ROWS)

    def beside(self) -> dict[str, str]:
        """Row of the paper by name of the row, for those that have one."""
        return {row.name: row.published for row in self.rows if row.published is not None}


def read_rows(path: Path) -> tuple[StudyRecord, dict[str, StudyModel]]:
    """A study file, and the models of the rows that are run, their paths resolved.

    Raises:
        InputError: it is missing or broken, a row is there twice, or none is run.
    """
    record = read_record(path, StudyRecord, ROWS_VERSION, _MEND, ROWS_FORMAT)
    models: dict[str, StudyModel] = {}
    names: set[str] = set()
    for row in record.rows:
        if row.name in names:
            raise InputError(path, row.name, "is listed twice", "give each row its own name")
        names.add(row.name)
        if row.source is not None:
            models[row.name] = StudyModel(_resolved(path.parent, row.source), row.axes)
    if not models:
        raise InputError(
            path,
            "rows",
            "have no source",
            "give the source of at least one row: a model or results",
        )
    return record, models


def _resolved(folder: Path, source: str) -> str:
    for prefix in (FILES, VIEWS, LIBRARY):
        if source.startswith(prefix):
            return f"{prefix}{folder / source.removeprefix(prefix)}"
    is_path = source.startswith((".", "/")) or is_vehicle_file(source)
    return str(folder / source) if is_path or (folder / source).exists() else source


def parse_models(texts: Sequence[str]) -> dict[str, StudyModel]:
    """NAME=WHAT of the command line as a table.

    Raises:
        InputError: no name, a name that cannot be a folder's, or one twice.
    """
    models: dict[str, StudyModel] = {}
    for text in texts:
        name, equals, source = text.partition("=")
        if not equals or not source or not _NAME.fullmatch(name):
            raise InputError(
                "`model`",
                text,
                "is not of the form NAME=WHAT",
                "give a name of letters, digits, '.', '_' and '-', then = and a model folder, "
                "a generator, a PLY, files:DIR or views:DIR",
            )
        if name in models:
            raise InputError("`model`", name, "is given twice", "give each model its own name")
        models[name] = StudyModel(source)
    return models


def model_hash(
    model: StudyModel, cases: Sequence[ActorCase], conditions: Sequence[str] = (CLEAN,)
) -> str:
    """What stands for a model in records; what could not be loaded later is refused here.

    Raises:
        InputError: no such generator, file or folder, a model folder at fault, or results of none
            of the vehicles.
    """
    what = model.source
    if model.folder is not None:
        return value_hash([_results_hash(model.on(condition), cases) for condition in conditions])
    path = Path(what)
    if path.is_dir():
        for check in verify_checkpoint(path):
            fault = check.fault(loading=True)
            if fault is not None:
                raise fault
    elif is_vehicle_file(what):
        if not path.is_file():
            raise InputError(path, "file", "is missing", "check the path given as `model`")
    elif what.startswith(LIBRARY):
        LibraryGenerator(what.removeprefix(LIBRARY))
    else:
        make_generator(what, model.axes)
    source = generator_source(what)
    return source if model.axes == AUTO else f"{source} {model.axes}"


def _results_hash(model: StudyModel, cases: Sequence[ActorCase]) -> dict[str, str]:
    assert model.folder is not None
    if not model.folder.is_dir():
        raise InputError(
            model.folder,
            "results",
            "is not a folder",
            "put the results there, or set the source of this row to null",
        )
    found = {case.id: vehicle_hash(model, case) for case in cases}
    if not any(found.values()):
        files = f"ID{', '.join(VEHICLE_SUFFIXES[:-1])} or {VEHICLE_SUFFIXES[-1]}"
        wanted = files if model.source.startswith(FILES) else "ID/VIEW.png"
        raise InputError(
            model.folder,
            "results",
            f"contain no {wanted} for any vehicle, such as {cases[0].id}",
            "name them as `recast eval inputs` lists them",
        )
    return found
