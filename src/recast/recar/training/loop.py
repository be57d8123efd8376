"""The training loop: the same steps whether or not it was interrupted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import torch

from recast.errors import InputError
from recast.recar.training.log import LOG_FILE, Means, TrainingLog
from recast.recar.training.processes import Processes
from recast.recar.training.settings import TrainerSettings
from recast.recar.training.state import TrainingState, steps_done
from recast.recar.training.task import StepRandom, TrainingTask
from recast.storage import alone_in, disk_errors

Watch = Callable[[int, dict[str, float]], None]
Probe = Callable[[], Mapping[str, float]]
AfterStep = Callable[[TrainingState], None]
_GIVE_UP = 20  # steps in a row whose loss or gradient is not finite


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
        task: what is trained.
        settings: how.
        folder: of the checkpoint and of `log.jsonl`, one line each `log_every` steps.
        watch: called with step and mean logs where a line is written.
        probe: gives further values for each line, measured just before it is written.
        after_step: called after every step, before its checkpoint is written.
        processes: this one among those that train together. `watch`, `probe` and `after_step` are
            called in the first one only.

    Raises:
        InputError: the folder holds another training, another process trains there, or the loss
            stays not finite.
    """
    processes = processes or Processes()
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if not processes.first:
        return _train(task, settings, folder, watch, probe, after_step, processes)
    # A process that has finished may still be on its way out.
    with alone_in(folder, wait=steps_done(folder) == settings.steps):
        return _train(task, settings, folder, watch, probe, after_step, processes)


def _train(
    task: TrainingTask,
    settings: TrainerSettings,
    folder: Path,
    watch: Watch | None,
    probe: Probe | None,
    after_step: AfterStep | None,
    processes: Processes,
) -> TrainingState:
    """`train` in a folder that no other training uses."""
    for module in task.modules.values():
        module.train()
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
                folder, f"step {state.step}", "the loss is not finite any more",
                "lower the learning rate, or train in float32",
            )  # fmt: skip
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
