"""`recast planner train`: a small GTRS planner from scored samples; resumes to the same weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.core.files import folder_name, write_bytes, write_json
from recast.core.records import Record, read_record
from recast.logs.images import encode
from recast.planning.gtrs import GtrsModel, GtrsPlanner, load_gtrs, save_gtrs
from recast.planning.gtrs.planner import CONFIG_FILE, WEIGHTS_FILE
from recast.recar.training import hash_files
from recast.training.loop import TrainingBar, train
from recast.training.state import TrainingState
from recast_tools.planner_training.evaluate import (
    FIRST_SPEED,
    SampleScores,
    decision_sheet,
    evaluate,
)
from recast_tools.planner_training.samples import (
    RECORD_FILE,
    RENDERERS,
    SampleStore,
)
from recast_tools.planner_training.task import (
    MINI_VIEWS,
    GtrsTask,
    PlannerTrainingConfig,
    first_model,
)

TRAINING_FILE = "planner_training.json"
_MEND = "name another output folder"
_SHEET_ROWS = 8
_SETTLING = 32
"""Batches over which the norms' statistics are taken for the averaged weights."""


class PlannerTrainingRecord(Record):
    """`planner_training.json`: what from and how, and at the end what it reaches.

    Attributes:
        config: configuration of the training.
        dataset_sha256: SHA-256 of each dataset's record; worlds may be added between two
            trainings, not during one.
        samples: number of samples that are trained on.
        held_out: number of samples that are held out.
        parameters: number of the planner's parameters.
        start_sha256: SHA-256 of the planner folder that it began from; None where weights were
            drawn.
        reached: scores on all held-out samples, by the weights that are exported; None before the
            end.
    """

    format: Literal["recast-planner-training"] = "recast-planner-training"
    version: Literal[1] = 1
    config: PlannerTrainingConfig
    dataset_sha256: list[str]
    samples: int
    held_out: int
    parameters: int
    start_sha256: str | None = None
    reached: dict[str, float | int | None] | None = None


@dataclass(frozen=True)
class _Setting:
    """What a training folder trains."""

    store: SampleStore
    task: GtrsTask
    held_out: NDArray[np.int64]
    record: PlannerTrainingRecord


def train_planner(
    datasets: Sequence[Path],
    out: Path,
    config: PlannerTrainingConfig,
    console: Console,
    start: Path | None = None,
) -> SampleScores:
    """Train in `out`, from its checkpoint where there is one, and judge the averaged weights.

    `out` gets `log.jsonl`, the checkpoint, sheets of held-out decisions and
    `planner_training.json`.

    Args:
        datasets: folders of samples that go together, such as those of one driver after another.
        start: folder of a GTRS planner of the same sizes, whose weights are the first; None: drawn.

    Raises:
        InputError: the datasets are too small or broken, or do not go together, `start` is no such
            planner, or `out` holds another training.
    """
    setting = _open(datasets, config, start)
    _check_same(out, setting.record)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / TRAINING_FILE, setting.record.model_dump(mode="json"))
    task, trainer = setting.task, config.trainer
    shown = _spread(setting.held_out, config.judged)

    def draw_sheet(name: str) -> None:
        sheet = decision_sheet(task, _spread(shown, _SHEET_ROWS), config.scoring)
        write_bytes(out / "sheets" / f"{name}.png", encode(sheet))

    with TrainingBar("planner", trainer.steps, console) as display:

        def after_step(state: TrainingState) -> None:
            display.step(state.step)
            if config.sheet_every and state.step % config.sheet_every == 0:
                draw_sheet(f"{state.step:07d}")

        state = train(
            task,
            trainer,
            out,
            after_step=after_step,
            probe=lambda: evaluate(task, shown, config.scoring).means(),
            watch=lambda step, values: display.means(step, values, trainer.rate(step - 1)),
        )
    _take_averages(state, task, trainer.seed)
    reached = evaluate(task, setting.held_out, config.scoring)
    draw_sheet("final")
    means = {k: v if np.isfinite(v) else None for k, v in reached.means().items()}
    record = setting.record.model_copy(update={"reached": {"samples": reached.samples, **means}})
    write_json(out / TRAINING_FILE, record.model_dump(mode="json"))
    return reached


def export_planner(
    training: Path,
    datasets: Sequence[Path],
    out: Path,
    mean_with: Path | None = None,
    share: float = 0.5,
) -> GtrsPlanner:
    """Write the planner of a training, finished or not, as a folder in float16; it has its name.

    Args:
        mean_with: folder of a planner of the same sizes, such as the one that the training began
            with, whose weights count for `share` of the mean with those of the training.
            Fine-tuned networks forget less so (Wortsman et al., "Robust fine-tuning of zero-shot
            models", 2022).

    Raises:
        InputError: no training is there, or it is of another dataset; `out` exists; `mean_with` is
            no such planner; `share` is not between 0 and 1.
    """
    if not 0.0 <= share <= 1.0:
        raise InputError("export", "share", f"is {share:g}", "give a share between 0 and 1")
    found = read_record(
        training / TRAINING_FILE,
        PlannerTrainingRecord,
        1,
        "name a folder that recast planner train wrote",
        "recast-planner-training",
    )
    setting = _open(datasets, found.config)
    begun = setting.record.model_copy(update={"start_sha256": found.start_sha256})
    _check_same(training, begun)
    trainer = found.config.trainer
    state = TrainingState.begin(setting.task.modules, trainer)
    state.read(training, trainer)
    if state.step == 0:
        raise InputError(training, "checkpoint", "is missing", "train for some steps first")
    model = setting.task.model
    other = None if mean_with is None else _weights_for(model, mean_with)
    _take_averages(state, setting.task, trainer.seed)
    if other is not None:
        own = model.state_dict()
        for name, weights in other.items():
            if weights.is_floating_point():
                own[name].lerp_(weights, share)
    planner = GtrsPlanner(
        model,
        setting.store.record.primitives,
        MINI_VIEWS,
        name=folder_name(out.resolve().name),
        weights=found.config.scoring,
    )
    save_gtrs(out, planner, torch.float16)
    return planner


def _open(
    datasets: Sequence[Path], config: PlannerTrainingConfig, start: Path | None = None
) -> _Setting:
    store = SampleStore(*datasets)
    used = np.isin(store.renderer, [RENDERERS.index(name) for name in config.renderers])
    train_on = np.flatnonzero(used & ~store.held_out)
    held_out = np.flatnonzero(used & store.held_out)
    if len(train_on) < config.batch or len(held_out) < 2:
        raise InputError(
            datasets[0],
            "samples",
            f"{len(train_on)} for training and {len(held_out)} held out are too few",
            f"make at least {config.batch} for training and 2 held out (every tenth world), "
            "rendered by one of `renderers`",
        )
    seed = config.trainer.seed
    model = first_model(seed, config.network)
    if start is not None:
        _begin_from(model, start)
    record = PlannerTrainingRecord(
        config=config,
        dataset_sha256=[hash_files(one, [one / RECORD_FILE]) for one in datasets],
        samples=len(train_on),
        held_out=len(held_out),
        parameters=sum(parameter.numel() for parameter in model.parameters()),
        start_sha256=None if start is None else hash_files(start, [start / WEIGHTS_FILE]),
    )
    task = GtrsTask(store, train_on, model, config.batch, config.kept)
    return _Setting(store, task, held_out, record)


def _begin_from(model: GtrsModel, folder: Path) -> None:
    """Give a model the weights of a planner's folder, whatever it chooses from."""
    # What looks at an earlier image is as it was drawn where the planner did not look at one.
    model.load_state_dict({**model.state_dict(), **_weights_for(model, folder)})


def _weights_for(model: GtrsModel, folder: Path) -> dict[str, Tensor]:
    """Weights of a planner's folder by name, which have the sizes of a model's."""
    found = load_gtrs(folder).model
    alike = found.config.model_copy(update={"history": model.config.history})
    if alike != model.config or (found.config.history and not model.config.history):
        raise InputError(
            folder / CONFIG_FILE,
            "model",
            "has other network sizes than the model to train",
            "name another planner, or give its sizes as `network` with `config`",
        )
    return found.state_dict()


def _check_same(folder: Path, record: PlannerTrainingRecord) -> None:
    """Check that what lies in a folder, if anything, is the same training."""
    path = folder / TRAINING_FILE
    if not path.exists():
        if folder.exists() and any(folder.iterdir()):
            raise InputError(folder, "output folder", "holds files of something else", _MEND)
        return
    found = read_record(path, PlannerTrainingRecord, 1, _MEND, record.format)
    for name in ("dataset_sha256", "samples", "held_out", "parameters", "start_sha256"):
        if getattr(found, name) != getattr(record, name):
            raise InputError(
                path, name, f"is {getattr(found, name)}, not {getattr(record, name)}", _MEND
            )
    # The state checks the trainer's settings; the others change no weights.
    free = {"trainer": True, "scoring": True, "judged": True, "sheet_every": True}
    if found.config.model_dump(exclude=free) != record.config.model_dump(exclude=free):
        raise InputError(path, "config", "differs from the requested configuration", _MEND)


def _spread(indices: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """At most `count` of them, evenly."""
    at = np.linspace(0, len(indices) - 1, min(count, len(indices))).astype(np.int64)
    return indices[at]


def _take_averages(state: TrainingState, task: GtrsTask, seed: int) -> None:
    """Give the model the averaged weights, and its norms the statistics that belong to them."""
    for name, average in state.averages.items():
        average.copy_to(state.modules[name])
    norms = [m for m in task.model.modules() if isinstance(m, nn.BatchNorm2d)]
    momentum = [norm.momentum for norm in norms]
    rng = np.random.default_rng([seed, len(norms)])
    task.model.train()
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # a plain mean over the batches
    with torch.no_grad():
        for _ in range(_SETTLING):
            chosen = rng.choice(task.indices, task.batch)
            batch = task.gather(chosen, FIRST_SPEED, rng.uniform(size=task.batch) < 0.5)
            task.model.backbone(batch.images)
    for norm, usual in zip(norms, momentum, strict=True):
        norm.momentum = usual
    task.model.eval()
