"""The training loop, in one process or those of torchrun: the same steps, interrupted or not."""

from __future__ import annotations

import atexit
import importlib
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import alone_in, disk_errors
from recast.training.state import TrainingState, steps_done
from recast.training.task import (
    LOG_FILE,
    Means,
    StepRandom,
    TrainerSettings,
    TrainingLog,
    TrainingTask,
)

Watch = Callable[[int, dict[str, float]], None]
Probe = Callable[[], Mapping[str, float]]
AfterStep = Callable[[TrainingState], None]
_GIVE_UP = 20  # steps in a row whose loss or gradient is not finite


@dataclass(frozen=True)
class Processes:
    """Which of how many processes this is.

    Each takes other parts of every batch; gradients are averaged, so that all hold the same
    weights. The first one alone writes files.

    Attributes:
        index, count: index of this process, and number of all processes.
        device: device on which this process computes; None leaves that to the caller.
    """

    index: int = 0
    count: int = 1
    device: torch.device | None = None

    @property
    def first(self) -> bool:
        """Whether this process writes files."""
        return self.index == 0

    @staticmethod
    def started() -> Processes:
        """Those of torchrun, by its environment variables; a single one without them.

        Raises:
            InputError: there are several, and accelerate is not installed.
        """
        if int(os.environ.get("WORLD_SIZE", "1")) == 1:
            return Processes()
        state = _accelerate().PartialState(cpu=not torch.cuda.is_available())
        atexit.register(_leave, state)
        return Processes(state.process_index, state.num_processes, torch.device(state.device))

    def wait(self) -> None:
        """Until all processes are here."""
        if self.count > 1:
            _accelerate().PartialState().wait_for_everyone()

    def average_gradients(self, parameters: Sequence[Tensor]) -> None:
        """Replace all gradients by their mean over the processes."""
        if self.count == 1:
            return
        for parameter in parameters:
            if parameter.grad is None:  # others may have one
                parameter.grad = torch.zeros_like(parameter)
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        flat = torch.cat([gradient.float().flatten() for gradient in gradients])
        mean = _accelerate().utils.reduce(flat, "mean").split([g.numel() for g in gradients])
        for gradient, part in zip(gradients, mean, strict=True):
            gradient.copy_(part.view_as(gradient))

    def merge(self, means: Means) -> Means:
        """Sums and counts over all processes; the names must be the same everywhere."""
        if self.count == 1:
            return means
        names = sorted(means.sums)
        device = self.device or "cpu"
        table = torch.tensor(
            [[means.sums[n] for n in names], [means.counts[n] for n in names]],
            dtype=torch.float64,
            device=device,
        )
        sums, counts = _accelerate().utils.reduce(table, "sum").tolist()
        return Means(dict(zip(names, sums, strict=True)), dict(zip(names, counts, strict=True)))


def _leave(state: Any) -> None:
    """End the group, and let its threads free the tensors of the last collective.

    Gloo's threads outlive the group (torch 2.13), and one that asks for Python's lock while the
    interpreter ends aborts the process. Sleeping gives them the lock before.
    """
    state.destroy_process_group()
    time.sleep(0.5)


def _accelerate() -> Any:
    try:
        return importlib.import_module("accelerate")
    except ImportError:
        raise InputError(
            "accelerate",
            "package",
            "is not installed, and several processes were started",
            "pip install 'recast-sim[distributed]'",
        ) from None


def train(
    task: TrainingTask,
    settings: TrainerSettings,
    folder: Path,
    *,
    watch: Watch | None = None,
    probe: Probe | None = None,
    after_step: AfterStep | None = None,
    processes: Processes | None = None,
) -> TrainingState:
    """Train a task to its last step, from the checkpoint in `folder` where there is one.

    Killed at any moment, it loses the steps since the last checkpoint, and the weights come out
    the same: every step's randomness depends on seed and step alone.

    With several processes the batch of a step has as many parts as processes times `accumulate`;
    two processes that accumulate once train as one process that accumulates twice, up to rounding.

    Args:
        task: task to train.
        settings: settings of the training.
        folder: folder of the checkpoint and of `log.jsonl`, one line each `log_every` steps.
        watch: function called with step and mean logs where a line is written.
        probe: function that gives further values for each line, measured just before it is written.
        after_step: function called after every step, before its checkpoint is written.
        processes: place of this process among those that train together. `watch`, `probe` and
            `after_step` are called in the first one only.

    Raises:
        InputError: the folder holds another training, another process trains there, or the loss
            stays not finite.
    """
    processes = processes or Processes()
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for module in task.modules.values():
        module.train()
    # A process that has finished may still be on its way out.
    alone = alone_in(folder, wait=steps_done(folder) == settings.steps)
    with alone if processes.first else nullcontext():
        state = TrainingState.begin(task.modules, settings)
        state.read(folder, settings)
        processes.wait()  # else the first one may write while another still reads
        log = None
        if processes.first:
            log = TrainingLog(folder / LOG_FILE, state.step, settings.log_every, state.pending)
        bad = 0
        while state.step < settings.steps:
            logs = _step(task, settings, state, processes)
            bad = 0 if _finite(logs) else bad + 1
            if bad == _GIVE_UP:
                raise InputError(
                    folder,
                    f"step {state.step}",
                    "the loss is not finite",
                    "lower the learning rate, or train in float32",
                )
            state.step += 1
            if log is None:
                continue
            state.pending.add(logs)
            if log.due(state.step):
                values = log.write(state.step, probe() if probe is not None else {})
                if watch is not None:
                    watch(state.step, values)
            if after_step is not None:
                after_step(state)
            if state.step % settings.checkpoint_every == 0 or state.step == settings.steps:
                state.write(folder, settings)
        processes.wait()  # the last checkpoint is there for all
        return state


def _step(
    task: TrainingTask, settings: TrainerSettings, state: TrainingState, processes: Processes
) -> dict[str, float]:
    """One step of the optimiser; left out where loss or gradients are not finite."""
    for group in state.optimiser.param_groups:
        group["lr"] = settings.rate(state.step)
    state.optimiser.zero_grad(set_to_none=True)
    found = Means()
    parts = settings.accumulate * processes.count
    for turn in range(settings.accumulate):
        part = turn * processes.count + processes.index
        one = task.loss(state.step, StepRandom.of(settings.seed, state.step, part, parts))
        (one.loss / settings.accumulate).backward()
        value = float(one.loss.detach())
        bad = 0.0 if math.isfinite(value) else 1.0
        found.add({"loss": value, "not_finite": bad, **one.logs})
    parameters = state.parameters()
    processes.average_gradients(parameters)
    logs = processes.merge(found).means()
    if state.clipper is not None:
        norm = state.clipper.clip(parameters)
    else:
        assert not isinstance(settings.clip, str)  # else there is a clipper
        norm = float(torch.nn.utils.clip_grad_norm_(parameters, settings.clip))
    logs["gradient"] = norm
    if _finite(logs):
        state.optimiser.step()
        for name, average in state.averages.items():
            average.update(state.modules[name])
    return logs


def _finite(logs: Mapping[str, float]) -> bool:
    """Whether the losses of all parts and the gradient of a step can be used."""
    return logs["not_finite"] == 0 and math.isfinite(logs["gradient"])
