"""What a generation study consists of: settings, and a job for every vehicle and model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recast.core.hashing import file_hash, folder_hash, value_hash
from recast.evaluation.actor_cases import ActorCase, ActorView, read_cases
from recast.evaluation.bootstrap import SAMPLES
from recast.evaluation.generation_placement import Placement
from recast.evaluation.generation_targets import Targets, target_case
from recast.pipeline.generation_maker import CellJob, Measures
from recast.pipeline.generation_results import CLEAN, PERTURBED, StudyModel, vehicle_hash
from recast.recar.perturb import PerturbationConfig

RECIPE = 2
"""Changes when the same model and vehicle give other scores, so that older cells are made anew."""


@dataclass(frozen=True)
class StudySettings:
    """What is studied.

    Attributes:
        models: what makes vehicles, by the name it has in the tables, in their order.
        folder: vehicle set or real crops, see `read_cases`.
        seed: of the input views, the models, the perturbations and the bootstrap.
        limit: only the first vehicles.
        perturbed: also judge on inputs perturbed like this, none of them left clean.
        placement: see `recast.evaluation.generation_placement`.
        measures: weights of scores.
        samples: of the bootstrap.
        shown: vehicles on sheets, the first ones.
        targets: see `recast.evaluation.generation_targets`.
        beside: rows of the paper to set beside those of these names, which need not be run.
    """

    models: Mapping[str, StudyModel]
    folder: Path
    seed: int = 0
    limit: int | None = None
    perturbed: PerturbationConfig | None = None
    placement: Placement = "views"
    measures: Measures = field(default_factory=Measures)
    samples: int = SAMPLES
    shown: int = 40
    targets: Targets = "set"
    beside: Mapping[str, str] = field(default_factory=dict)

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the blocks of the table."""
        return (CLEAN,) if self.perturbed is None else (CLEAN, PERTURBED)


def study_cases(settings: StudySettings) -> list[ActorCase]:
    """The vehicles, with the views that they are compared in.

    Raises:
        InputError: see `read_cases` and `orbit_case`.
    """
    cases = read_cases(settings.folder, settings.seed, settings.limit)
    return [target_case(case, settings.targets) for case in cases]


def truth_folder(out: Path, vehicle: str) -> Path:
    """Where the photographs' cell of a vehicle lies."""
    return out / "truth" / vehicle


def cell_folder(out: Path, condition: str, model: str, vehicle: str) -> Path:
    """Where the cell of a vehicle by a model lies."""
    return out / "cells" / condition / model / vehicle


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
            model = what.on(condition)
            befell = befalls if config is not None else None
            for case in cases:
                # results by vehicle are each their own: those of others may come later
                source = sources[name] if model.folder is None else vehicle_hash(model, case)
                with_all = [shared, source, settings.placement, befell]
                key = value_hash([with_all, keys[case.id]])
                folder = cell_folder(out, condition, name, case.id)
                jobs.append(CellJob(case, key, folder, model, config))
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
