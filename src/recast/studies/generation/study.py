"""`recast eval generation`: several models on the same held-out vehicles (RECAST, section 5, Q3).

docs/recar.md lists what it writes. `write_inputs` writes what generators that run elsewhere need:
inputs/ID.png, inputs/perturbed/ID.png, targets.json and study.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PilImage

from recast.actors.vehicle_files import VEHICLE_SUFFIXES
from recast.core.artefact import file_hash, folder_hash, value_hash
from recast.core.diagnostics import Progress
from recast.core.errors import InputError, require_range
from recast.core.files import (
    atomic_file,
    atomic_folder,
    folder_name,
    read_json,
    write_json,
    write_text,
)
from recast.metrics.actor_scores import (
    ActorCase,
    ActorView,
    Targets,
    elevation_deg,
    read_cases,
    target_case,
)
from recast.metrics.table import SAMPLES, rounded
from recast.recar.perturb import PerturbationConfig
from recast.recar.views import Image
from recast.studies.generation.cells import (
    CellTask,
    Measures,
    Placement,
    StudyCell,
    cell_is,
    make_cells,
    perturbed_input,
    read_cell,
    read_strip,
)
from recast.studies.generation.report import (
    StudyBlock,
    study_json,
    study_markdown,
    summarize,
)
from recast.studies.generation.rows import (
    CLEAN,
    PERTURBED,
    RowRecord,
    StudyModel,
    StudyRecord,
    model_hash,
    vehicle_hash,
    view_name,
)
from recast.studies.sheets import SheetRow, applied_caption, pages, sheet

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
    """Hashes of the weights that are given; what is not there is refused when it is loaded."""
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


STUDY_FILE, METRICS_FILE, MARKDOWN_FILE = "study.json", "metrics.json", "study.md"
TIMINGS_FILE = "timings.json"
STUDY_FORMAT = "recast-generation-study"


def run_study(
    settings: StudySettings, out: Path, *, workers: int = 1, progress: Progress | None = None
) -> tuple[StudyBlock, ...]:
    """Make every vehicle by every model from every input, score, compare, and write it all.

    What a killed run finished is kept, and so is what an earlier study in `out` made of the same
    vehicle by the same model with the same settings: models and vehicles can be added. All files
    but the timings are the same bytes for any number of workers (processes). Returns a block of the
    table for every condition.

    Args:
        out: folder that is new, empty, or of an earlier study.
        progress: function that is given the number of vehicles done, and of all, those of all
            models and inputs.

    Raises:
        InputError: the set, a model, weights or `out` are at fault; no vehicle was made by every
            model; a process was killed.
    """
    require_range(1, workers=workers, samples=settings.samples)
    if not settings.models:
        raise InputError("`model`", "models", "none is given", "give NAME=WHAT at least once")
    cases = study_cases(settings)
    sources = {
        name: model_hash(what, cases, settings.conditions) for name, what in settings.models.items()
    }
    tasks = plan_tasks(settings, cases, sources, out)
    _begin(out, settings, cases, sources)
    left = [task for task in tasks if not cell_is(task.folder, task.key)]
    _make(left, settings, out, workers, len(tasks), progress)
    blocks = _summaries(settings, cases, out)
    facts = _facts(settings, sources)
    write_json(out / METRICS_FILE, study_json(facts, blocks))
    write_text(out / MARKDOWN_FILE, study_markdown(facts, blocks))
    _write_sheets(settings, cases, out)
    write_json(out / STUDY_FILE, _record(settings, cases, sources, complete=True))
    return blocks


def _begin(
    out: Path, settings: StudySettings, cases: Sequence[ActorCase], sources: Mapping[str, str]
) -> None:
    if out.exists() and not out.is_dir():
        raise InputError(out, "output folder", "is a file", "choose another folder")
    if out.is_dir() and any(out.iterdir()):
        path = out / STUDY_FILE
        record = read_json(path) if path.is_file() else None
        if not isinstance(record, dict) or record.get("format") != STUDY_FORMAT:
            raise InputError(
                out,
                "output folder",
                "contains other files than those of a study",
                "choose another folder, or empty this one",
            )
    write_json(out / STUDY_FILE, _record(settings, cases, sources, complete=False))


def _record(
    settings: StudySettings, cases: Sequence[ActorCase], sources: Mapping[str, str], complete: bool
) -> dict[str, Any]:
    return {
        "format": STUDY_FORMAT,
        "version": 1,
        "complete": complete,
        **_facts(settings, sources),
        "vehicles": [case.id for case in cases],
    }


def _facts(settings: StudySettings, sources: Mapping[str, str]) -> dict[str, Any]:
    """What was studied, in plain values that do not depend on where files lie."""
    perturbed, hashes = settings.perturbed, measure_hashes(settings.measures)
    return {
        "set": settings.folder.resolve().name,
        "models": {
            name: {"source": what.label, "hash": sources[name]}
            for name, what in settings.models.items()
        },
        "seed": settings.seed,
        "placement": settings.placement,
        "perturbations": None if perturbed is None else perturbed.model_dump(mode="json"),
        "measures": {
            name: {"source": path.name, "hash": hashes[name]}
            for name, path in vars(settings.measures).items()
            if path is not None
        },
        "samples": settings.samples,
        "targets": settings.targets,
        "beside": dict(settings.beside),
    }


def _make(
    left: Sequence[CellTask],
    settings: StudySettings,
    out: Path,
    workers: int,
    total: int,
    progress: Progress | None,
) -> None:
    done = total - len(left)
    seconds: dict[str, dict[str, float]] = {}

    def on_done(task: CellTask, took: dict[str, float]) -> None:
        nonlocal done
        done += 1
        seconds[task.folder.relative_to(out).as_posix()] = took
        if progress is not None:
            progress(done, total)

    if progress is not None:
        progress(done, total)
    try:
        if left:
            make_cells(left, settings.measures, settings.seed, settings.placement, workers, on_done)
    finally:
        path = out / TIMINGS_FILE
        before = read_json(path) if path.is_file() else {}
        write_json(path, rounded(dict(sorted({**before, **seconds}.items()))))


def _summaries(
    settings: StudySettings, cases: Sequence[ActorCase], out: Path
) -> tuple[StudyBlock, ...]:
    truth = {case.id: read_cell(truth_folder(out, case.id)) for case in cases}
    blocks = []
    for condition in settings.conditions:
        cells = {
            name: [read_cell(cell_folder(out, condition, name, case.id)) for case in cases]
            for name in settings.models
        }
        _check_some_made(cells)
        try:
            blocks.append(
                summarize(condition, cells, truth, seed=settings.seed, samples=settings.samples)
            )
        except ValueError as error:
            raise InputError(
                out, "vehicles", str(error), "read the reasons in cells/*/*/*/cell.json"
            ) from None
    return tuple(blocks)


def _check_some_made(cells: Mapping[str, Sequence[StudyCell]]) -> None:
    for name, mine in cells.items():
        if all(cell.failure is not None for cell in mine):
            raise InputError(
                name,
                "vehicles",
                f"none could be made; {mine[0].id}: {mine[0].failure}",
                "check that the model fits these images, or leave it out",
            )


def _write_sheets(settings: StudySettings, cases: Sequence[ActorCase], out: Path) -> None:
    for old in out.glob("sheet_*.png"):
        old.unlink()
    for condition in settings.conditions:
        rows = [_row(settings, condition, case, out) for case in cases[: settings.shown]]
        for number, page in enumerate(pages(rows)):
            picture = sheet(f"{condition} input", list(settings.models), page)
            with atomic_file(out / f"sheet_{condition}_{number:02d}.png") as partial:
                PilImage.fromarray(picture).save(partial, format="PNG")


def _row(settings: StudySettings, condition: str, case: ActorCase, out: Path) -> SheetRow:
    truth = truth_folder(out, case.id)
    applied = read_cell(truth).facts["perturbations"] if condition == PERTURBED else []
    folders = [cell_folder(out, condition, name, case.id) for name in settings.models]
    return SheetRow(
        applied_caption(case.id, applied),
        read_strip(truth, "input" if condition == CLEAN else PERTURBED),
        [read_strip(one) if read_cell(one).failure is None else None for one in folders],
        read_strip(truth),
    )
