"""`training.json`: what a stage was trained from and how, and what it cost."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import torch
from pydantic import ConfigDict, Field

from recast.errors import InputError
from recast.recar.training.stage_config import FlowName, StageConfig
from recast.records import Record, read_record
from recast.storage import write_json

RECORD_FILE = "training.json"
_FORMAT = "recast-training"
_VERSION = 1


class FlowRecord(Record):
    """One flow of a stage.

    Attributes:
        steps: done.
        parameters: trained.
        seconds: of wall time over all log lines, evaluation and sheets included.
        last: means of the last log line.
    """

    steps: int
    parameters: int
    seconds: float
    last: dict[str, float]


class StageInputs(Record):
    """What a stage was trained from; a resumed one must be from the same.

    Attributes:
        config: of the stage.
        model, targets, pictures: names of the folders, for people.
        model_sha256: of `pipeline.json` and all model files.
        targets_sha256: of `cache.json`, all records and the decisions of a person.
        pictures_sha256: of the records of a set or of its shards, or of all assets.
        train, held_out: vehicles that were used.
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
        weights: which weights the new model holds.
        unscreened: targets that were trained on though no person had decided about them; None
            where there was nothing to screen, such as for training assets, and in older records.
        flows: what each cost.
        processes: that trained together, last time.
        device: that trained.
        peak_bytes: most memory in use, last time; of the accelerator, or of the first process.
        torch, python: versions.
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
    mend = "name a folder that recast recar train wrote"
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
        names = set(StageInputs.model_fields) - {"config"}
        for name in sorted(names):
            if getattr(found, name) != getattr(inputs, name):
                raise InputError(
                    path, f"inputs.{name}", f"is {getattr(found, name)!r}, not "
                    f"{getattr(inputs, name)!r}", "name another output folder",
                )  # fmt: skip
        _check_config(path, found.config, inputs.config)
    elif folder.exists() and any(folder.iterdir()):
        raise InputError(
            folder, "output folder", f"holds something else: no {RECORD_FILE} is there",
            "name another one",
        )  # fmt: skip


def _check_config(path: Path, found: StageConfig, asked: StageConfig) -> None:
    free = {"structure", "latent", "name", "probe", "sheet_every", "sheet_vehicles",
            "token_memory_mib"}  # fmt: skip
    same_flows = found.settings.keys() == asked.settings.keys()
    if not same_flows or found.model_dump(exclude=free) != asked.model_dump(exclude=free):
        raise InputError(
            path, "inputs.config", "differs from the one asked for", "name another output folder"
        )


def hash_files(folder: Path, files: Iterable[Path]) -> str:
    """SHA-256 of files below a folder, by their names there and their contents."""
    digest = hashlib.sha256()
    for path in sorted(files):
        content = hashlib.sha256()
        with path.open("rb") as stream:
            while block := stream.read(1 << 22):
                content.update(block)
        digest.update(f"{path.relative_to(folder).as_posix()} {content.hexdigest()}\n".encode())
    return digest.hexdigest()
