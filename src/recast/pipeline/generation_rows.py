"""The rows of a generation study: of the command line, and of a study file.

See `recast.pipeline.generation_results` for what a row can be.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from recast.actors import make_generator
from recast.actors.axes import AUTO
from recast.actors.library import LIBRARY, LibraryGenerator
from recast.actors.vehicle_files import is_vehicle_file
from recast.core.hashing import value_hash
from recast.errors import InputError
from recast.evaluation.actor_cases import ActorCase
from recast.evaluation.generation_published import PAPER_ROWS
from recast.evaluation.generation_targets import Targets
from recast.pipeline.generation_results import CLEAN, FILES, VIEWS, StudyModel, vehicle_hash
from recast.pipeline.sources import generator_source
from recast.recar.perturb import PerturbationConfig
from recast.recar.record import Text
from recast.records import Record, read_record
from recast.trellis import verify_checkpoint

ROWS_FORMAT = "recast-generation-rows"
ROWS_VERSION = 1

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")
_MOST_ROWS = 64
_MEND = "correct the study file; docs/recar.md, section Judging a model"


def _check_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError("letters, digits, '.', '_' and '-', at most 40, the first one no sign")
    return name


def _check_published(row: str | None) -> str | None:
    if row is not None and row not in PAPER_ROWS:
        raise ValueError(f"is none of {', '.join(PAPER_ROWS)}")
    return row


class RowRecord(Record):
    """A row in a study file.

    Attributes:
        name: in tables and folders.
        source: of its vehicles, paths from the study file's folder; None if it is not run.
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
        seed: of everything random, the choice of the input views too.
        targets: see `recast.evaluation.generation_targets`.
        perturbations: of the perturbed inputs; None where all are clean.
        rows: in the order of the table.
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
            raise InputError(path, row.name, "is there twice", "name each row once")
        names.add(row.name)
        if row.source is not None:
            models[row.name] = StudyModel(_resolved(path.parent, row.source), row.axes)
    if not models:
        raise InputError(path, "rows", "have no source", "name a model or results of one row")
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
                "--model", text, "is not NAME=WHAT",
                "give a name of letters, digits, '.', '_' and '-', then = and a model folder, "
                "a generator, a PLY, files:DIR or views:DIR",
            )  # fmt: skip
        if name in models:
            raise InputError("--model", name, "is named twice", "name each model once")
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
            raise InputError(path, "file", "is missing", "check the path given as --model")
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
            model.folder, "results", "are no folder",
            "put the results there, or write null for the source of their row",
        )  # fmt: skip
    found = {case.id: vehicle_hash(model, case) for case in cases}
    if not any(found.values()):
        wanted = "ID.ply, .glb or .obj" if model.source.startswith(FILES) else "ID/VIEW.png"
        raise InputError(
            model.folder, "results", f"hold no {wanted} of any vehicle, such as {cases[0].id}",
            "name them as `recast eval inputs` lists them",
        )  # fmt: skip
    return found
