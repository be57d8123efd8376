"""How the flows are trained in one stage, those of the paper among them; and training.json."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

import torch
from pydantic import ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from recast.core.errors import InputError
from recast.core.files import read_json, write_json
from recast.core.records import Record, read_record, validation_error
from recast.recar.perturb import PerturbationConfig
from recast.training.state import TrainerSettings, overridden

FlowName = Literal["structure", "latent"]


class FlowObjective(Record):
    """What is learnt from a batch.

    Attributes:
        batch: vehicles a step, over all processes and accumulated parts together.
        condition_drop: probability for a sample to lose its condition.
        time_mean, time_std: mean and standard deviation of the normal numbers whose logistic
            function gives the times.
        sigma_min: noise left at t = 0.
        autocast: compute in this type on CUDA, with weights, moments and averages in float32; a
            CPU computes in float32 in any case.
    """

    batch: int = Field(default=2, ge=1, le=65536)
    condition_drop: float = Field(default=0.1, ge=0, le=1)
    time_mean: FiniteFloat = 1.0
    time_std: FiniteFloat = Field(default=1.0, gt=0)
    sigma_min: float = Field(default=1e-5, ge=0, lt=1)
    autocast: Literal["bfloat16"] | None = "bfloat16"


class StageConfig(Record):
    """One stage.

    Attributes:
        name: name for people.
        structure, latent: settings with which each flow is trained; None leaves it as it is.
        objective: objective of both flows.
        perturbation: perturbation of the pictures of conditions; {} in a file takes all defaults,
            None leaves all clean.
        train_encoder: train the image encoder together with the structure flow, instead of
            keeping it frozen; for small models, whose encoder nothing has trained before.
        checkpointing: recompute activations in the backward pass to save memory.
        weights: weights that are written into the new model: the moving average, or the latest
            weights.
        token_memory_mib: bound on the tokens of clean pictures that are kept in memory.
        probe: number of held-out vehicles on which the gap between true and shuffled conditions is
            measured with every line of the log; 0 for none.
        sheet_every: number of steps between sample sheets; 0 for none.
        sheet_vehicles: number of held-out vehicles on them.
    """

    name: str
    structure: TrainerSettings | None
    latent: TrainerSettings | None
    objective: FlowObjective = FlowObjective()
    perturbation: PerturbationConfig | None = None
    train_encoder: bool = False
    checkpointing: bool = True
    weights: Literal["average", "raw"] = "average"
    token_memory_mib: int = Field(default=1024, ge=0)
    probe: int = Field(default=8, ge=0)
    sheet_every: int = Field(default=1000, ge=0)
    sheet_vehicles: int = Field(default=4, ge=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name, settings in self.settings.items():
            if self.objective.batch < settings.accumulate:
                raise ValueError(
                    f"{name}: a batch of {self.objective.batch} does not split into "
                    f"{settings.accumulate} parts"
                )
            if self.weights == "average" and settings.ema_decay is None:
                raise ValueError(f"{name}: weights are the average, but ema_decay is null")
        if self.train_encoder and self.structure is None:
            raise ValueError("train_encoder: the encoder can only train with the structure flow")
        return self

    @property
    def settings(self) -> dict[FlowName, TrainerSettings]:
        """How each flow that is trained is trained, the structure first."""
        pairs: tuple[tuple[FlowName, TrainerSettings | None], ...] = (
            ("structure", self.structure),
            ("latent", self.latent),
        )
        return {name: settings for name, settings in pairs if settings is not None}


def _trainer(steps: int, lr: float, **changes: Any) -> TrainerSettings:
    fields = {"ema_decay": 0.9999, "checkpoint_every": 500, "log_every": 50} | changes
    return TrainerSettings.model_validate({"steps": steps, "lr": lr, **fields})


STAGE_1 = StageConfig(
    name="stage-1", structure=_trainer(10_000, 1e-5), latent=_trainer(16_000, 1e-5)
)
"""Vehicles (paper, section 2): clean pictures, towards the pseudo-targets."""

STAGE_2 = StageConfig(
    name="stage-2",
    structure=_trainer(12_000, 2e-6),
    latent=_trainer(12_000, 2e-6),
    perturbation=PerturbationConfig(),
)
"""Robustness (paper, section 2): the same targets, four pictures in five perturbed."""

BASE = StageConfig(
    name="base",
    structure=_trainer(9_000, 1e-3, schedule="cosine", warmup=400, ema_decay=0.999),
    latent=_trainer(3_000, 1e-3, schedule="cosine", warmup=200, ema_decay=0.998),
    objective=FlowObjective(batch=4),
    checkpointing=False,
)
"""The small model before its adaptation; its image encoder was trained before and stays."""

BASE_2 = BASE.model_copy(
    update={
        "name": "base-2",
        "structure": _trainer(12_000, 8e-4, schedule="cosine", warmup=200, ema_decay=0.999),
        "latent": _trainer(4_800, 1e-3, schedule="cosine", warmup=100, ema_decay=0.998),
    }
)
"""A second round of the base, from the weights of the first."""

_MINI = STAGE_1.model_copy(update={"objective": FlowObjective(batch=4), "checkpointing": False})

MINI_STAGE_1 = _MINI.model_copy(
    update={
        "name": "mini-stage-1",
        "structure": _trainer(2_500, 3e-4, schedule="cosine", warmup=50, ema_decay=0.998),
        "latent": _trainer(1_000, 3e-4, schedule="cosine", warmup=50, ema_decay=0.998),
    }
)
"""Stage I of the small model: higher rates and fewer steps than those of half a billion weights."""

MINI_STAGE_2 = MINI_STAGE_1.model_copy(
    update={"name": "mini-stage-2", "perturbation": STAGE_2.perturbation}
)
"""Stage II of the small model."""

PRESETS: Mapping[str, StageConfig] = {
    one.name: one for one in (STAGE_1, STAGE_2, BASE, BASE_2, MINI_STAGE_1, MINI_STAGE_2)
}
COMMAND_NAMES: Mapping[str, StageConfig] = {
    "1": STAGE_1,
    "2": STAGE_2,
    "base": BASE,
    "base-2": BASE_2,
    "mini-1": MINI_STAGE_1,
    "mini-2": MINI_STAGE_2,
}
"""What `stage` takes."""


def read_stage_config(path: Path) -> StageConfig:
    """Read a JSON file: all members of a `StageConfig`, or "preset" and what differs from it.

    Raises:
        InputError: no such file or preset, a member unknown or out of range.
    """
    mend = "correct it; see docs/recar.md#training"
    values = read_json(path)
    if not isinstance(values, dict):
        raise InputError(path, "JSON", "is not an object", mend)
    preset = values.pop("preset", None)
    if preset is not None and preset not in PRESETS:
        raise InputError(path, "preset", f"is {preset!r}", f"use one of {', '.join(PRESETS)}")
    start = {} if preset is None else PRESETS[preset].model_dump(mode="json")
    try:
        return StageConfig.model_validate(overridden(start, values))
    except ValidationError as error:
        raise validation_error(path, error, mend) from None


def chosen_stage(stage: str | None, file: Path | None) -> StageConfig:
    """The stage that a command names, or a file; exactly one of them.

    Raises:
        InputError: none or both are given, or the file is wrong.
    """
    if (stage is None) == (file is None):
        problem = (
            "is missing, and so is `config`" if stage is None else "is given together with `config`"
        )
        raise InputError("`stage`", "value", problem, "give one of the two")
    if file is not None:
        return read_stage_config(file)
    return COMMAND_NAMES[str(stage)]


RECORD_FILE = "training.json"
_FORMAT = "recast-training"
_VERSION = 1
_MEND_OUT = "choose another output folder"


class FlowRecord(Record):
    """One flow of a stage.

    Attributes:
        seconds: seconds of wall time over all log lines, evaluation and sheets included.
        last: means of the last log line.
    """

    steps: int
    parameters: int
    seconds: float
    last: dict[str, float]


class StageInputs(Record):
    """What a stage was trained from; a resumed one must be from the same.

    Attributes:
        model, targets, pictures: names of the folders, for people.
        model_sha256: SHA-256 of `pipeline.json` and all model files.
        targets_sha256: SHA-256 of `cache.json`, all records and the ids that a person left out.
        pictures_sha256: SHA-256 of the records of a set and the ids that a person left out, or
            of all assets.
        train, held_out: number of vehicles that were used, for training and held out.
    """

    model_config = ConfigDict(protected_namespaces=())

    config: StageConfig
    model: str
    model_sha256: str
    targets: str
    targets_sha256: str
    pictures: str
    pictures_sha256: str
    train: int
    held_out: int


class TrainingRecord(Record):
    """Contents of training.json.

    Attributes:
        complete: False while the stage is in training.
        unscreened: number of targets that were trained on though no person had decided about them;
            None where there was nothing to screen, such as for training assets, and in older
            records.
        processes: number of processes that trained together, last time.
        peak_bytes: most memory in use, last time; of the accelerator, or of the first process.
    """

    format: Literal["recast-training"] = "recast-training"
    version: int = _VERSION
    complete: bool
    inputs: StageInputs
    weights: Literal["average", "raw"]
    unscreened: int | None = None
    flows: dict[FlowName, FlowRecord] = Field(default_factory=dict)
    processes: int = 1
    device: str
    peak_bytes: int | None = None
    torch: str = torch.__version__
    python: str = platform.python_version()

    def write(self, folder: Path) -> None:
        """Write training.json."""
        write_json(folder / RECORD_FILE, self.model_dump(mode="json"))


def read_training_record(folder: Path) -> TrainingRecord:
    """Read training.json of a model folder.

    Raises:
        InputError: missing, or wrong.
    """
    mend = "give a folder that recast recar train wrote"
    return read_record(folder / RECORD_FILE, TrainingRecord, _VERSION, mend, _FORMAT)


def check_same_inputs(folder: Path, inputs: StageInputs) -> None:
    """Check that what lies in `folder`, if anything, was trained from the same.

    Raises:
        InputError: it was not, or the folder holds something else.
    """
    path = folder / RECORD_FILE
    if path.exists():
        found = read_training_record(folder).inputs
        # A course that may go on longer is judged by the state of each flow.
        for name in sorted(set(StageInputs.model_fields) - {"config"}):
            theirs, ours = getattr(found, name), getattr(inputs, name)
            if theirs != ours:
                raise InputError(path, f"inputs.{name}", f"is {theirs!r}, not {ours!r}", _MEND_OUT)
        _check_config(path, found.config, inputs.config)
    elif folder.exists() and any(folder.iterdir()):
        problem = f"contains other files, but no {RECORD_FILE}"
        raise InputError(folder, "output folder", problem, "choose another folder")


def _check_config(path: Path, found: StageConfig, asked: StageConfig) -> None:
    free = {"structure", "latent", "name"}
    free |= {"probe", "sheet_every", "sheet_vehicles", "token_memory_mib"}
    same_flows = found.settings.keys() == asked.settings.keys()
    if not same_flows or found.model_dump(exclude=free) != asked.model_dump(exclude=free):
        raise InputError(path, "inputs.config", "differs from the requested one", _MEND_OUT)
