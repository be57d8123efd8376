"""What a generation study consists of, and what generators that run elsewhere need for it.

`write_inputs` writes inputs/ID.png, inputs/perturbed/ID.png, targets.json and study.json
(docs/recar.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PilImage

from recast.actors.vehicle_files import VEHICLE_SUFFIXES
from recast.arrays import Image
from recast.core.artefact import file_hash, folder_hash, value_hash
from recast.core.files import atomic_folder, write_json
from recast.core.names import folder_name
from recast.metrics.cases import (
    ActorCase,
    ActorView,
    Targets,
    elevation_deg,
    read_cases,
    target_case,
)
from recast.metrics.pairs import SAMPLES
from recast.metrics.table import rounded
from recast.recar.perturb import PerturbationConfig
from recast.studies.generation.cell import Placement
from recast.studies.generation.maker import CellTask, Measures, perturbed_input
from recast.studies.generation.rows import (
    CLEAN,
    PERTURBED,
    RowRecord,
    StudyModel,
    StudyRecord,
    vehicle_hash,
    view_name,
)

RECIPE = 3
"""Changes when the same model and vehicle give other scores, so that older cells are made anew."""
INPUTS, TARGETS_FILE, ROWS_FILE = "inputs", "targets.json", "study.json"
PAPER_STUDY = (
    ("real3d", None, "Real3D"),
    ("ln3diff", None, "LN3Diff"),
    ("3dtopia-xl", None, "3DTopia-XL"),
    ("sar3d", None, "SAR3D"),
    ("asset-harvester", None, "Asset Harvester"),
    ("trellis", "./trellis", "TRELLIS"),
    ("stage1", "./stage1", "Stage I only"),
    ("both", "./both", "both stages"),
)
"""Name, source and row of the paper: other generators, and the ablation of the two stages."""


@dataclass(frozen=True)
class StudySettings:
    """What is studied.

    Attributes:
        models: what makes vehicles, by the name it has in the tables, in their order.
        folder: vehicle set or real crops, see `read_cases`.
        seed: seed of the input views, the models, the perturbations and the bootstrap.
        limit: number of vehicles to take, the first ones; None for all.
        perturbed: also judge on inputs perturbed like this, none of them left clean.
        shown: number of vehicles on sheets, the first ones.
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
        InputError: see `read_cases` and `target_case`.
    """
    cases = read_cases(settings.folder, settings.seed, settings.limit)
    return [target_case(case, settings.targets) for case in cases]


def truth_folder(out: Path, vehicle: str) -> Path:
    """Where the photographs' cell of a vehicle lies."""
    return out / "truth" / vehicle


def cell_folder(out: Path, condition: str, model: str, vehicle: str) -> Path:
    """Where the cell of a vehicle by a model lies."""
    return out / "cells" / condition / model / vehicle


def plan_tasks(
    settings: StudySettings, cases: Sequence[ActorCase], sources: Mapping[str, str], out: Path
) -> list[CellTask]:
    """All cells, those of one model in a row."""
    shared = {
        "recipe": RECIPE,
        "seed": settings.seed,
        "measures": measure_hashes(settings.measures),
    }
    perturbed = settings.perturbed
    befalls = None if perturbed is None else perturbed.model_dump(mode="json")
    keys = {case.id: _case_key(case) for case in cases}
    tasks = [
        CellTask(
            case,
            value_hash([shared, keys[case.id], befalls]),
            truth_folder(out, case.id),
            None,
            perturbed,
        )
        for case in cases
    ]
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
                tasks.append(CellTask(case, key, folder, model, config))
    return tasks


def _case_key(case: ActorCase) -> list[Any]:
    views = [*case.inputs, *case.targets]
    return [case.id, case.category, case.size.tolist(), len(case.inputs), *map(_view_key, views)]


def _view_key(view: ActorView) -> list[Any]:
    camera = view.camera
    return [
        view.name,
        camera.width,
        camera.height,
        camera.matrix.tolist(),
        view.camera_from_actor.tolist(),
    ]


def measure_hashes(measures: Measures) -> dict[str, str]:
    """Of the weights that are given; what is not there is refused when it is loaded."""
    return {
        name: folder_hash(path) if path.is_dir() else file_hash(path) if path.is_file() else ""
        for name, path in vars(measures).items()
        if path is not None
    }


def write_inputs(settings: StudySettings, out: Path) -> list[ActorCase]:
    """Write inputs, target views and a file of rows, all or nothing; return the vehicles.

    Args:
        settings: settings of the study; its models do not matter.

    Raises:
        InputError: the set is at fault, `out` exists, or the disk is full.
    """
    cases = study_cases(settings)
    with atomic_folder(out) as partial:
        for case in cases:
            name = f"{folder_name(case.id)}.png"
            _save(case.inputs[0].load(), partial / INPUTS / name)
            if settings.perturbed is not None:
                rgba, _ = perturbed_input(case, settings.seed, settings.perturbed)
                _save(rgba, partial / INPUTS / PERTURBED / name)
        vehicles = [_vehicle(case) for case in cases]
        write_json(partial / TARGETS_FILE, rounded({"version": 1, "vehicles": vehicles}))
        record = StudyRecord(
            seed=settings.seed,
            targets=settings.targets,
            perturbations=settings.perturbed,
            rows=tuple(
                RowRecord(name=name, source=source, published=row)
                for name, source, row in PAPER_STUDY
            ),
        )
        write_json(partial / ROWS_FILE, record.model_dump(mode="json"))
    return cases


def _save(rgba: Image, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    PilImage.fromarray(rgba, "RGBA").save(path, format="PNG")


def _vehicle(case: ActorCase) -> dict[str, Any]:
    name = folder_name(case.id)
    return {
        "id": case.id,
        "files": [f"{name}{suffix}" for suffix in VEHICLE_SUFFIXES],
        "input": f"{INPUTS}/{name}.png",
        "input_azimuth_deg": case.inputs[0].azimuth_deg,
        "input_elevation_deg": elevation_deg(case.inputs[0]),
        "size_m": case.size.tolist(),
        "targets": [_target(name, view) for view in case.targets],
    }


def _target(vehicle: str, view: ActorView) -> dict[str, Any]:
    camera = view.camera
    distance = float(np.linalg.norm(view.camera_from_actor[:3, 3]))
    return {
        "file": f"{vehicle}/{view_name(view.name)}",
        "width": camera.width,
        "height": camera.height,
        "fov_deg": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "azimuth_deg": view.azimuth_deg,
        "elevation_deg": elevation_deg(view),
        "distance_m": distance,
        "camera_from_actor": view.camera_from_actor.tolist(),
    }
