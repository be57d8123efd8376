"""`recast eval generation`: several models on the same held-out vehicles (RECAST, section 5, Q3).

docs/recar.md lists what it writes; each vehicle and model is a folder of
`recast.studies.generation.cell`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from recast.core.errors import InputError, require_range
from recast.core.files import atomic_file, read_json, write_json, write_text
from recast.core.progress import Progress
from recast.metrics.cases import ActorCase
from recast.metrics.table import rounded
from recast.studies.generation.cell import StudyCell, cell_is, read_cell, read_strip
from recast.studies.generation.maker import CellTask, make_cells
from recast.studies.generation.plan import (
    StudySettings,
    cell_folder,
    measure_hashes,
    plan_tasks,
    study_cases,
    truth_folder,
)
from recast.studies.generation.report import StudyFacts, study_json, study_markdown
from recast.studies.generation.rows import CLEAN, PERTURBED, model_hash
from recast.studies.generation.summary import StudyBlock, summarize
from recast.studies.sheets import SheetRow, applied_caption, pages, sheet

STUDY_FILE, METRICS_FILE, MARKDOWN_FILE = "study.json", "metrics.json", "study.md"
TIMINGS_FILE = "timings.json"
STUDY_FORMAT = "recast-generation-study"


def run_study(
    settings: StudySettings,
    out: Path,
    *,
    workers: int = 1,
    progress: Progress | None = None,
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
    settings: StudySettings,
    cases: Sequence[ActorCase],
    sources: Mapping[str, str],
    complete: bool,
) -> dict[str, Any]:
    return {
        "format": STUDY_FORMAT,
        "version": 1,
        "complete": complete,
        **_facts(settings, sources).to_json(),
        "vehicles": [case.id for case in cases],
    }


def _facts(settings: StudySettings, sources: Mapping[str, str]) -> StudyFacts:
    perturbed, hashes = settings.perturbed, measure_hashes(settings.measures)
    return StudyFacts(
        set=settings.folder.resolve().name,
        models={
            name: {"source": what.label, "hash": sources[name]}
            for name, what in settings.models.items()
        },
        seed=settings.seed,
        placement=settings.placement,
        perturbations=None if perturbed is None else perturbed.model_dump(mode="json"),
        measures={
            name: {"source": path.name, "hash": hashes[name]}
            for name, path in vars(settings.measures).items()
            if path is not None
        },
        samples=settings.samples,
        targets=settings.targets,
        beside=dict(settings.beside),
    )


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
                Image.fromarray(picture).save(partial, format="PNG")


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
