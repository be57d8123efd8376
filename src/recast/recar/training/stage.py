"""One stage of the adaptation: from a model folder to a new one, through either or both flows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from rich.console import Console
from torch import nn

from recast.core.errors import InputError
from recast.recar.perturb import PerturbationConfig, perturb
from recast.recar.training.conditions import ConditionTokens, Perturb
from recast.recar.training.flow_task import ConditionGap, Flow, FlowTask, LatentFlow, StructureFlow
from recast.recar.training.output import (
    FlowRecord,
    TrainingRecord,
    check_same_inputs,
    write_trained_model,
)
from recast.recar.training.sheets import StageSheets
from recast.recar.training.stage_config import FlowName
from recast.recar.training.stage_parts import StageParts, StageRequest, open_stage
from recast.recar.views import Image
from recast.training.loop import Processes, train
from recast.training.state import TrainingState, steps_done
from recast.training.task import (
    LOG_FILE,
    Means,
    TrainerSettings,
    TrainingBar,
    read_log_lines,
    tensorboard_writer,
)
from recast.trellis.checkpoints.pipeline_record import LATENT_FLOW, STRUCTURE_FLOW
from recast.trellis.generation import Stopwatch

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
            raise InputError(
                "`flow`",
                "latent",
                "needs the image encoder, which trains with the structure flow",
                "train the structure flow first",
            )
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
        sheets = self._sheets(name, task.tokens) if self.processes.first else None
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

    def _sheets(self, name: FlowName, tokens: ConditionTokens) -> StageSheets | None:
        """What draws sheets after steps, where some are wanted."""
        config = self.config
        identities = self.parts.held_out[: config.sheet_vehicles]
        if config.sheet_every == 0 or not identities:
            return None
        return StageSheets(
            self.model,
            self.parts.targets,
            identities,
            tokens,
            self.request.out / SHEETS / name,
            config.sheet_every,
            config.weights == "average",
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
