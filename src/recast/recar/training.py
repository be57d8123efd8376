"""The two-stage adaptation: from a model folder to a new one, through either or both flows.

`train_stage` opens and checks what a stage needs, trains its flows and writes the model.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from torch import nn

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.files import atomic_file, write_bytes
from recast.recar.perturb import PerturbationConfig, perturb
from recast.recar.target_cache import TargetCache
from recast.recar.training_conditions import (
    ConditionSource,
    ConditionTokens,
    Perturb,
    SetConditions,
    open_conditions,
)
from recast.recar.training_config import (
    FlowName,
    FlowRecord,
    StageConfig,
    StageInputs,
    TrainingRecord,
    check_same_inputs,
)
from recast.recar.training_flow import (
    ConditionGap,
    Flow,
    FlowTask,
    LatentFlow,
    StageSheets,
    StructureFlow,
)
from recast.recar.vehicle_set import SET_FILE
from recast.training.loop import (
    LOG_FILE,
    Processes,
    TrainingBar,
    read_log_lines,
    tensorboard_writer,
    train,
)
from recast.training.state import Means, TrainerSettings, TrainingState, steps_done
from recast.trellis import ImageTo3D
from recast.trellis.checkpoints import BACKBONE_FOLDER, PipelineRecord
from recast.trellis.generate import Stopwatch
from recast.trellis.layers import TrellisModel
from recast.trellis.model_files import LATENT_FLOW, PIPELINE_FILE, STRUCTURE_FLOW, save_model

_SHOWN = 3


@dataclass(frozen=True)
class StageRequest:
    """What is trained, from what, into which folder.

    Attributes:
        model: folder in the published layout that training starts from.
        out: folder of the new model; one of the same training is continued.
        image_encoder: weights of the published encoder, where `model` has none.
        device: device such as "cuda:0"; None takes CUDA where there is some.
        tensorboard: whether to write curves into OUT/tensorboard too.
        flows: flows to train now; all of the stage where none is named. Several processes can each
            train one; the last to finish writes the model.
    """

    config: StageConfig
    model: Path
    targets: Path
    pictures: Path
    out: Path
    image_encoder: Path | None = None
    device: str | None = None
    tensorboard: bool = False
    flows: tuple[FlowName, ...] = ()


@dataclass(frozen=True)
class StageParts:
    """A request that was opened.

    Attributes:
        train, held_out: vehicles with a target that is used.
        unscreened: number of vehicles in `train` that no person decided about; None where they
            are no pseudo-targets, since the pictures are those of training assets.
    """

    model: ImageTo3D
    targets: TargetCache
    pictures: ConditionSource
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    unscreened: int | None
    inputs: StageInputs


def open_stage(request: StageRequest, processes: Processes) -> StageParts:
    """Open model, targets and pictures, and check that they belong together.

    Raises:
        InputError: one of them is missing or broken, targets are of another size than the model
            makes, a target has no picture, a vehicle is in both splits, or a flow is asked for
            that the stage does not train.
    """
    config = request.config
    for flow in request.flows:
        if flow not in config.settings:
            raise InputError(
                "`flow`", flow, f"is not trained by {config.name}", "choose another flow"
            )
    for name, settings in config.settings.items():
        parts = settings.accumulate * processes.count
        if parts > config.objective.batch:
            raise InputError(
                "stage",
                "objective.batch",
                f"is {config.objective.batch}, less than {parts} parts of {name} "
                f"({processes.count} processes, accumulate {settings.accumulate})",
                "raise it, or use fewer processes",
            )
    targets = TargetCache.open(request.targets)
    pictures = open_conditions(request.pictures)
    train, held_out = targets.ids("train"), targets.ids("held-out")
    decisions = pictures.decisions if isinstance(pictures, SetConditions) else {}
    left_out = {name for name, decision in decisions.items() if decision == "no"}
    train = tuple(one for one in train if one not in left_out)
    held_out = tuple(one for one in held_out if one not in left_out)
    _check_pictures(request, pictures, train, held_out)
    device = processes.device or request.device
    model = ImageTo3D.load(
        request.model,
        device=None if device is None else str(device),
        torso_dtype=torch.float32,
        image_encoder=request.image_encoder,
    )
    if config.train_encoder and model.checkpoint.record.encoder_role is None:
        problem = "is the published one, which cannot be trained"
        raise InputError(request.model, "image encoder", problem, "set train_encoder to false")
    _check_sizes(request, model, targets, (*train, *held_out))
    inputs = StageInputs(
        config=config,
        model=request.model.resolve().name,
        model_sha256=hash_files(request.model, model_paths(request.model, model.checkpoint.record)),
        targets=request.targets.resolve().name,
        targets_sha256=_targets_hash(targets),
        pictures=request.pictures.resolve().name,
        pictures_sha256=_pictures_hash(request.pictures, left_out),
        train=len(train),
        held_out=len(held_out),
    )
    unscreened = None
    if isinstance(pictures, SetConditions):
        unscreened = sum(one not in {**targets.decisions, **decisions} for one in train)
    return StageParts(model, targets, pictures, train, held_out, unscreened, inputs)


def _check_pictures(
    request: StageRequest, pictures: ConditionSource, train: Sequence[str], held_out: Sequence[str]
) -> None:
    known = set(pictures.ids)
    missing = [one for one in (*train, *held_out) if one not in known or pictures.count(one) == 0]
    if missing:
        problem = f"{len(missing)} vehicles with a target have no images: {_listed(missing)}"
        mend = "give the set that the targets were made from"
        raise InputError(request.pictures, "pictures", problem, mend)
    if isinstance(pictures, SetConditions):
        wrong = tuple(one for one in train if pictures.split(one) != "train")
        wrong += tuple(one for one in held_out if pictures.split(one) != "held-out")
        if wrong:
            problem = f"of {len(wrong)} vehicles differs from that of the set: {_listed(wrong)}"
            mend = "make the targets again from this set"
            raise InputError(request.targets, "split", problem, mend)


def _check_sizes(
    request: StageRequest, model: ImageTo3D, targets: TargetCache, identities: Sequence[str]
) -> None:
    latent: Any = model.latent_flow.config
    if targets.record.model.resolution != latent.resolution:
        raise InputError(
            request.targets,
            "resolution",
            f"of the targets is {targets.record.model.resolution}, but the model makes "
            f"{latent.resolution}",
            "make the targets with a model of the same size",
        )
    for identity in identities[:1]:
        one = targets.target(identity)
        found = [*one.structure.shape, one.latent.shape[1]]
        expected = [*model.structure_shape, model.latent_channels]
        if found != expected:
            problem = f"has structure and latent of {found}, but the model makes {expected}"
            mend = "make the targets with a model of the same size"
            raise InputError(request.targets, identity, problem, mend)


def _targets_hash(targets: TargetCache) -> str:
    """Hash of what says which targets there are; latents follow from it."""
    folder = targets.folder
    files = [*folder.glob("*.json"), *folder.glob("records/[!.]*.json")]
    left_out = {name for name, decision in targets.decisions.items() if decision == "no"}
    return _with_names(hash_files(folder, files), left_out)


def _pictures_hash(folder: Path, left_out: Set[str]) -> str:
    """Hash of the records of a set; assets, which have none, are read whole."""
    records = [folder / SET_FILE, *folder.glob("[!.]*/identity.json")]
    found = [path for path in records if path.is_file()]
    return _with_names(hash_files(folder, found or folder.glob("[!.]*.npz")), left_out)


def _with_names(digest: str, left_out: Set[str]) -> str:
    # Of the decisions only: notes may be written into screening.csv while a stage is in training.
    if not left_out:
        return digest
    return hashlib.sha256(" ".join([digest, *sorted(left_out)]).encode()).hexdigest()


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


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


def hash_files(folder: Path, files: Iterable[Path]) -> str:
    """SHA-256 of files below a folder, by their names there and their contents."""
    digest = hashlib.sha256()
    for path in sorted(files):
        with path.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        digest.update(f"{path.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()


ROLES: dict[FlowName, str] = {"structure": STRUCTURE_FLOW, "latent": LATENT_FLOW}
TRAINING = "training"
SHEETS = "sheets"


def train_stage(
    request: StageRequest, *, console: Console | None = None, processes: Processes | None = None
) -> tuple[FlowName, ...]:
    """Train the flows of a stage, and write the model that comes out when all are trained.

    OUT becomes a model folder in the published layout with `training.json`; besides, it holds the
    state and log of each flow (training/structure, training/latent) and sample sheets. Killed at
    any moment, the same call continues, and ends in the same bytes.

    Args:
        processes: place of this process among those that train together; that of torchrun where not
            given.

    Returns:
        Flows of the stage that are still to be trained, where only some were asked for; the model
        is then not written yet.

    Raises:
        InputError: see `open_stage` and `train`; or OUT holds another training or something else,
            or the latent flow needs an image encoder that is still to be trained.
    """
    processes = processes or Processes.started()
    console = console or Console(quiet=not processes.first)
    parts = open_stage(request, processes)
    check_same_inputs(request.out, parts.inputs)
    processes.wait()  # else one may see what another has written, and take it for older
    return _Stage(request, parts, processes, console).run()


class _Stage:
    """A stage in training."""

    def __init__(
        self, request: StageRequest, parts: StageParts, processes: Processes, console: Console
    ) -> None:
        self.request, self.parts, self.processes = request, parts, processes
        self.console, self.config, self.model = console, request.config, parts.model
        self.watch = Stopwatch(parts.model.device)
        self.flows: dict[FlowName, FlowRecord] = {}
        self.writer: Any = None
        if request.tensorboard and processes.first:
            self.writer = tensorboard_writer(request.out / "tensorboard")
        if parts.model.device.type == "cuda":
            # Sums in a fixed order, so that a resumed training repeats them.
            os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
            torch.use_deterministic_algorithms(True, warn_only=True)

    def run(self) -> tuple[FlowName, ...]:
        """Train, and where no flow is left write the model and say so in the record."""
        if self.parts.unscreened:
            self.console.print(
                f"{self.request.targets}: {self.parts.unscreened} of the {len(self.parts.train)} "
                "training targets are not screened; screen them with recast recar screen",
                markup=False,
                soft_wrap=True,
            )
        for model in self.model.checkpoint.models.values():
            model.requires_grad_(False)
        for parameter in _parameters(self.model.encoder):
            parameter.requires_grad_(False)
        self._record(complete=False)
        asked = self.request.flows or tuple(self.config.settings)
        first = [n for n in self.config.settings if n in asked or self._is_trained(n)]
        if self.config.train_encoder and "structure" not in first:
            problem = "needs the image encoder, which trains with the structure flow"
            raise InputError("`flow`", "latent", problem, "train the structure flow first")
        trained = self._train_all(first)
        # Another process may have finished the other flow by now.
        others = [n for n in self.config.settings if n not in first]
        finished = [n for n in others if self._is_trained(n)]
        trained |= self._train_all(finished)
        left = tuple(n for n in others if n not in finished)
        if left:
            return left
        if self.processes.first:
            write_trained_model(
                self.request.model, self.request.out, self.model.checkpoint.record, trained
            )
        self._record(complete=True)
        self.processes.wait()
        return ()

    def _is_trained(self, name: FlowName) -> bool:
        """Whether a flow's checkpoint is of its last step; all processes say the same."""
        done = steps_done(self.request.out / TRAINING / name)
        found = Means()
        found.add({"trained": float(done == self.config.settings[name].steps)})
        return self.processes.merge(found).means()["trained"] == 1.0

    def _train_all(self, names: Sequence[FlowName]) -> dict[str, Any]:
        """Train flows, or load those that are trained; the modules to write by role."""
        trained: dict[str, Any] = {}
        for name in names:
            for what, module in self._train(name, self.config.settings[name]).items():
                role = self.model.checkpoint.record.encoder_role if what != "flow" else None
                trained[role or ROLES[name]] = module
        return trained

    def _train(self, name: FlowName, settings: TrainerSettings) -> dict[str, nn.Module]:
        """Train one flow; its modules then hold the weights that are written."""
        folder = self.request.out / TRAINING / name
        task = self._task(name)
        for module in task.modules.values():
            module.requires_grad_(True)
        held_out = self.parts.held_out
        probe = None
        if self.processes.first and min(len(held_out), self.config.probe) >= 2:
            probe = ConditionGap(task, task.tokens, held_out[: self.config.probe])
        sheets, shown = None, held_out[: self.config.sheet_vehicles]
        if self.processes.first and self.config.sheet_every and shown:
            stem, every = self.request.out / SHEETS / name, self.config.sheet_every
            mean = self.config.weights == "average"
            sheets = StageSheets(
                self.model, self.parts.targets, shown, task.tokens, stem, every, mean
            )
        with TrainingBar(name, settings.steps, self.console, self.writer) as display:

            def after_step(state: TrainingState) -> None:
                display.step(state.step)
                if sheets is not None:
                    sheets(state)

            state = train(
                task,
                settings,
                folder,
                probe=probe,
                after_step=after_step,
                watch=lambda step, values: display.means(step, values, settings.rate(step - 1)),
                processes=self.processes,
            )
        if self.config.weights == "average":
            for key, average in state.averages.items():
                average.copy_to(state.modules[key])
        lines = read_log_lines(folder / LOG_FILE)
        self.flows[name] = FlowRecord(
            steps=state.step,
            parameters=sum(parameter.numel() for parameter in state.parameters()),
            seconds=round(sum(line["seconds"] for line in lines), 1),
            last={k: v for k, v in lines[-1].items() if k != "seconds"} if lines else {},
        )
        for module in task.modules.values():
            module.requires_grad_(False).eval()
        return dict(task.modules)

    def _task(self, name: FlowName) -> FlowTask:
        config, model = self.config, self.model
        flow: Flow
        if name == "structure":
            flow = StructureFlow(model.structure_flow)
        else:
            flow = LatentFlow(model.latent_flow, model.latent_mean, model.latent_std)
        flow.model.checkpointing = config.checkpointing
        objective = config.objective
        if model.device.type != "cuda":
            objective = objective.model_copy(update={"autocast": None})
        encoder: Any = model.encoder if config.train_encoder and name == "structure" else None
        tokens = ConditionTokens(
            model.encoder,
            self.parts.pictures,
            model.device,
            frozen=encoder is None,
            kept_bytes=config.token_memory_mib << 20,
        )
        alter, clean_share = _perturbation(config.perturbation)
        return FlowTask(
            flow,
            self.parts.targets,
            self.parts.train,
            tokens,
            objective,
            alter,
            clean_share,
            encoder,
        )

    def _record(self, complete: bool) -> None:
        if not self.processes.first:
            return
        TrainingRecord(
            complete=complete,
            inputs=self.parts.inputs,
            weights=self.config.weights,
            unscreened=self.parts.unscreened,
            flows=self.flows,
            processes=self.processes.count,
            device=str(self.model.device),
            peak_bytes=self.watch.peak_bytes() if complete else None,
        ).write(self.request.out)


def _perturbation(config: PerturbationConfig | None) -> tuple[Perturb | None, float]:
    """What alters pictures, and the share rho of those that it leaves alone."""
    if config is None:
        return None, 1.0
    always = config.model_copy(update={"rho_clean": 0.0})  # drawn by the task

    def alter(rgba: Image, rng: np.random.Generator) -> Image:
        return perturb(rgba, always, rng).rgba

    return alter, config.rho_clean


def _parameters(encoder: Any) -> list[nn.Parameter]:
    return list(encoder.parameters()) if isinstance(encoder, nn.Module) else []
