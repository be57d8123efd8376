"""One stage of the adaptation: from a model folder to a new one, through either or both flows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from rich.console import Console
from torch import nn

from recast.recar.perturb import PerturbationConfig, perturb
from recast.recar.picture import Image
from recast.recar.training.display import TrainingDisplay, tensorboard_writer
from recast.recar.training.flow_task import FlowTask
from recast.recar.training.latents import Flow, LatentFlow, StructureFlow
from recast.recar.training.log import LOG_FILE, read_log_lines
from recast.recar.training.loop import train
from recast.recar.training.model_output import write_trained_model
from recast.recar.training.probe import ConditionGap
from recast.recar.training.processes import Processes
from recast.recar.training.settings import TrainerSettings
from recast.recar.training.sheet import SheetRow, sample_sheet
from recast.recar.training.stage_config import FlowName
from recast.recar.training.stage_parts import StageParts, StageRequest, open_stage
from recast.recar.training.state import TrainingState
from recast.recar.training.tokens import ConditionTokens, Perturb, View
from recast.recar.training.training_record import (
    FlowRecord,
    TrainingRecord,
    check_same_inputs,
)
from recast.storage import write_bytes
from recast.trellis.checkpoints.roles import LATENT_FLOW, STRUCTURE_FLOW
from recast.trellis.sparse import SparseTensor
from recast.trellis.stopwatch import Stopwatch

ROLES: dict[FlowName, str] = {"structure": STRUCTURE_FLOW, "latent": LATENT_FLOW}
TRAINING = "training"
SHEETS = "sheets"
_SEED = 20_260  # of sheets: the same noise and views throughout


def train_stage(
    request: StageRequest, *, console: Console | None = None, processes: Processes | None = None
) -> Path:
    """Train the flows of a stage, and write the model that comes out.

    OUT becomes a model folder in the published layout with `training.json`; besides, it holds the
    state and log of each flow (training/structure, training/latent) and sample sheets. Killed at
    any moment, the same call continues, and ends in the same bytes.

    Args:
        request: what, from what, where to.
        console: of the display.
        processes: this one among those that train together; those of torchrun where not given.

    Returns:
        OUT.

    Raises:
        InputError: see `open_stage` and `train`; or OUT holds another training or something else.
    """
    processes = processes or Processes.started()
    console = console or Console(quiet=not processes.first)
    parts = open_stage(request, processes)
    check_same_inputs(request.out, parts.inputs)
    processes.wait()  # else one may see what another has written, and take it for older
    stage = _Stage(request, parts, processes, console)
    stage.run()
    return request.out


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

    def run(self) -> None:
        """Train, write the model, and say so in the record."""
        for model in self.model.checkpoint.models.values():
            model.requires_grad_(False)
        for parameter in _parameters(self.model.encoder):
            parameter.requires_grad_(False)
        self._record(complete=False)
        trained: dict[str, Any] = {}
        for name, settings in self.config.settings.items():
            for what, module in self._train(name, settings).items():
                role = self.model.checkpoint.record.encoder_role if what != "flow" else None
                trained[role or ROLES[name]] = module
        if self.processes.first:
            write_trained_model(
                self.request.model, self.request.out, self.model.checkpoint.record, trained
            )
        self._record(complete=True)
        self.processes.wait()

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
        sheets = self._sheets(name, task.tokens) if self.processes.first else None
        with TrainingDisplay(name, settings.steps, self.console, self.writer) as display:

            def after_step(state: TrainingState) -> None:
                display.step(state.step)
                if sheets is not None:
                    sheets(state)

            state = train(
                task, settings, folder, probe=probe, after_step=after_step,
                watch=lambda step, values: display.means(step, values, settings.rate(step - 1)),
                processes=self.processes,
            )  # fmt: skip
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
            model.encoder, self.parts.pictures, model.device,
            frozen=encoder is None, kept_bytes=config.token_memory_mib << 20,
        )  # fmt: skip
        alter, clean_share = _perturbation(config.perturbation)
        return FlowTask(
            flow, self.parts.targets, self.parts.train, tokens, objective, alter, clean_share,
            encoder,
        )  # fmt: skip

    def _sheets(self, name: FlowName, tokens: ConditionTokens) -> Any:
        """Called after each step: draws a sheet where one is due."""
        every, count = self.config.sheet_every, self.config.sheet_vehicles
        identities = self.parts.held_out[:count]
        if every == 0 or not identities:
            return None
        rng = np.random.default_rng(_SEED)
        rows = [self._row(one, tokens, rng) for one in identities]

        def draw(state: TrainingState) -> None:
            if state.step % every:
                return
            with _written_weights(state, average=self.config.weights == "average"):
                sheet = sample_sheet(self.model, rows, _SEED)
            path = self.request.out / SHEETS / f"{name}-{state.step:07d}.png"
            write_bytes(path, _png(sheet))

        return draw

    def _row(self, identity: str, tokens: ConditionTokens, rng: np.random.Generator) -> SheetRow:
        view = View(identity, int(rng.integers(tokens.source.count(identity))))
        target, device = self.parts.targets.target(identity), self.model.device
        latent = SparseTensor.stack(
            [torch.from_numpy(target.coords).to(device)],
            [torch.from_numpy(target.latent).to(device)],
        )
        return SheetRow(
            identity, tokens.crop(view, None, rng), tokens.source.picture(identity, view.index),
            self.model.decode(latent)[0].to("cpu"),
        )  # fmt: skip

    def _record(self, complete: bool) -> None:
        if not self.processes.first:
            return
        self.request.out.mkdir(parents=True, exist_ok=True)
        TrainingRecord(
            complete=complete,
            inputs=self.parts.inputs,
            weights=self.config.weights,
            flows=self.flows,
            processes=self.processes.count,
            device=str(self.model.device),
            peak_bytes=self.watch.peak_bytes() if complete else None,
        ).write(self.request.out)


@contextmanager
def _written_weights(state: TrainingState, *, average: bool) -> Iterator[None]:
    """The weights that would be written now; those in training are put back to the bit."""
    if not average:
        yield
        return
    kept = {n: {k: v.clone() for k, v in m.state_dict().items()} for n, m in state.modules.items()}
    for name, one in state.averages.items():
        one.copy_to(state.modules[name])
    try:
        yield
    finally:
        for name, module in state.modules.items():
            module.load_state_dict(kept[name])


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


def _png(sheet: Image) -> bytes:
    written, data = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    assert written
    return data.tobytes()
