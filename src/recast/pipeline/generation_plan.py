"""What a generation study consists of: settings, and a job for every vehicle and model."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recast.actors import make_generator
from recast.actors.library import LIBRARY, LibraryGenerator
from recast.actors.vehicle_files import is_vehicle_file
from recast.errors import InputError
from recast.evaluation.actor_cases import ActorCase, ActorView
from recast.evaluation.bootstrap import SAMPLES
from recast.evaluation.generation_placement import Placement
from recast.pipeline.fingerprint import file_hash, folder_hash, value_hash
from recast.pipeline.generation_maker import CellJob, Measures
from recast.pipeline.sources import generator_source
from recast.recar.perturb import PerturbationConfig
from recast.trellis import verify_checkpoint

CLEAN, PERTURBED = "clean", "perturbed"

RECIPE = 2
"""Changes when the same model and vehicle give other scores, so that older cells are made anew."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")


@dataclass(frozen=True)
class StudySettings:
    """What is studied.

    Attributes:
        models: what makes vehicles, by the name it has in the tables, in their order; see
            `recast.pipeline.actor.generator_of`.
        folder: vehicle set or real crops, see `read_cases`.
        seed: of the input views, the models, the perturbations and the bootstrap.
        limit: only the first vehicles.
        perturbed: also judge on inputs perturbed like this, none of them left clean.
        placement: see `recast.evaluation.generation_placement`.
        measures: weights of scores.
        samples: of the bootstrap.
        shown: vehicles on sheets, the first ones.
    """

    models: Mapping[str, str]
    folder: Path
    seed: int = 0
    limit: int | None = None
    perturbed: PerturbationConfig | None = None
    placement: Placement = "views"
    measures: Measures = field(default_factory=Measures)
    samples: int = SAMPLES
    shown: int = 40

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the blocks of the table."""
        return (CLEAN,) if self.perturbed is None else (CLEAN, PERTURBED)


def parse_models(texts: Sequence[str]) -> dict[str, str]:
    """NAME=WHAT of the command line as a table.

    Raises:
        InputError: none, no name, a name that cannot be a folder's, or one twice.
    """
    if not texts:
        raise InputError("--model", "models", "none given", "give NAME=FOLDER at least once")
    models: dict[str, str] = {}
    for text in texts:
        name, equals, source = text.partition("=")
        if not equals or not source or not _NAME.fullmatch(name):
            raise InputError(
                "--model", text, "is not NAME=WHAT",
                "give a name of letters, digits, '.', '_' and '-', then = and a model folder, "
                "a generator or a PLY",
            )  # fmt: skip
        if name in models:
            raise InputError("--model", name, "is named twice", "name each model once")
        models[name] = source
    return models


def truth_folder(out: Path, vehicle: str) -> Path:
    """Where the photographs' cell of a vehicle lies."""
    return out / "truth" / vehicle


def cell_folder(out: Path, condition: str, model: str, vehicle: str) -> Path:
    """Where the cell of a vehicle by a model lies."""
    return out / "cells" / condition / model / vehicle


def model_hash(what: str) -> str:
    """What stands for a model in keys; what could not be loaded later is refused here.

    Raises:
        InputError: no such generator or file, or a model folder at fault.
    """
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
        make_generator(what)
    return generator_source(what)


def plan_jobs(
    settings: StudySettings, cases: Sequence[ActorCase], sources: Mapping[str, str], out: Path
) -> list[CellJob]:
    """All cells, those of one model in a row."""
    shared = {
        "recipe": RECIPE, "seed": settings.seed, "measures": measure_hashes(settings.measures)
    }  # fmt: skip
    perturbed = settings.perturbed
    befalls = None if perturbed is None else perturbed.model_dump(mode="json")
    keys = {case.id: _case_key(case) for case in cases}
    jobs = [
        CellJob(
            case, value_hash([shared, keys[case.id], befalls]), truth_folder(out, case.id), None,
            perturbed,
        )
        for case in cases
    ]  # fmt: skip
    for name, what in settings.models.items():
        for condition in settings.conditions:
            config = perturbed if condition == PERTURBED else None
            with_all = [
                shared, sources[name], settings.placement, befalls if config is not None else None
            ]  # fmt: skip
            jobs += [
                CellJob(
                    case, value_hash([with_all, keys[case.id]]),
                    cell_folder(out, condition, name, case.id), what, config,
                )
                for case in cases
            ]  # fmt: skip
    return jobs


def _case_key(case: ActorCase) -> list[Any]:
    views = [*case.inputs, *case.targets]
    return [case.id, case.category, case.size.tolist(), len(case.inputs), *map(_view_key, views)]


def _view_key(view: ActorView) -> list[Any]:
    camera = view.camera
    return [
        view.name, camera.width, camera.height, camera.matrix.tolist(),
        view.camera_from_actor.tolist(),
    ]  # fmt: skip


def measure_hashes(measures: Measures) -> dict[str, str]:
    """Of the weights that are given; what is not there is refused when it is loaded."""
    return {
        name: folder_hash(path) if path.is_dir() else file_hash(path) if path.is_file() else ""
        for name, path in vars(measures).items()
        if path is not None
    }
