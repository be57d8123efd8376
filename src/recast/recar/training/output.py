"""What a stage leaves: a model folder in the published layout, and `training.json`."""

from __future__ import annotations

import hashlib
import platform
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import torch
from pydantic import ConfigDict, Field

from recast.core.errors import InputError
from recast.core.files import atomic_file, write_bytes, write_json
from recast.core.records import Record, read_record
from recast.recar.training.stage_config import FlowName, StageConfig
from recast.trellis.checkpoints import BACKBONE_FOLDER
from recast.trellis.layers import TrellisModel
from recast.trellis.model_files import PIPELINE_FILE, PipelineRecord, save_model

RECORD_FILE = "training.json"
_FORMAT = "recast-training"
_VERSION = 1
_MEND_OUT = "choose another output folder"


def model_paths(folder: Path, record: PipelineRecord) -> list[Path]:
    """`pipeline.json` and the files of all models of a folder that are there."""
    stems = [folder / stem for stem in record.models.values()]
    files = [s.parent / f"{s.name}{end}" for s in stems for end in (".json", ".safetensors")]
    return [folder / PIPELINE_FILE, *(path for path in files if path.is_file())]


def write_trained_model(
    source: Path, out: Path, record: PipelineRecord, trained: Mapping[str, TrellisModel]
) -> None:
    """Write trained models by role, and copy everything else that a model folder holds.

    `pipeline.json` comes last, so that a folder cut short is no model. Weights have the precision
    that the source's had.

    Raises:
        InputError: the disk is full.
    """
    stems = {out / record.models[role] for role in trained}
    for path in model_paths(source, record)[1:]:
        target = out / path.relative_to(source)
        if target.parent / path.stem not in stems:
            _copy(path, target)
    backbone = source / BACKBONE_FOLDER
    for path in sorted(backbone.rglob("*")) if backbone.is_dir() else []:
        if path.is_file():
            _copy(path, out / path.relative_to(source))
    for role, model in trained.items():
        model.set_torso_dtype(torch.float16 if model.config.use_fp16 else torch.float32)
        save_model(out / record.models[role], model)
    write_bytes(out / PIPELINE_FILE, (source / PIPELINE_FILE).read_bytes())


def _copy(source: Path, target: Path) -> None:
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)


class FlowRecord(Record):
    """One flow of a stage.

    Attributes:
        steps: number of steps done.
        parameters: number of trained parameters.
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
        config: configuration of the stage.
        model, targets, pictures: names of the folders, for people.
        model_sha256: SHA-256 of `pipeline.json` and all model files.
        targets_sha256: SHA-256 of `cache.json`, all records and the decisions of a person.
        pictures_sha256: SHA-256 of the records of a set or of its shards, or of all assets.
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
        inputs: what it was trained from.
        weights: kind of weights that the new model holds.
        unscreened: number of targets that were trained on though no person had decided about them;
            None where there was nothing to screen, such as for training assets, and in older
            records.
        flows: cost of each flow.
        processes: number of processes that trained together, last time.
        device: device that trained.
        peak_bytes: most memory in use, last time; of the accelerator, or of the first process.
        torch, python: versions of PyTorch and Python.
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


def hash_files(folder: Path, files: Iterable[Path]) -> str:
    """SHA-256 of files below a folder, by their names there and their contents."""
    digest = hashlib.sha256()
    for path in sorted(files):
        with path.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        digest.update(f"{path.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()
