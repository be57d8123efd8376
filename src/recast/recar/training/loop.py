"""The training loop: the same steps whether or not it was interrupted."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import torch

from recast.errors import InputError
from recast.recar.training.settings import TrainerSettings
from recast.recar.training.state import TrainingState
from recast.recar.training.task import StepRandom, TrainingTask

LOG_FILE = "log.jsonl"
Watch = Callable[[int, dict[str, float]], None]
_GIVE_UP = 20  # losses in a row that are not finite


def train(
    task: TrainingTask,
    settings: TrainerSettings,
    folder: Path,
    *,
    watch: Watch | None = None,
) -> TrainingState:
    """Train a task to its last step, from the checkpoint in `folder` where there is one.

    Killed at any moment, it loses the steps since the last checkpoint, and the weights come out
    the same: every step's randomness depends on seed and step alone.

    Args:
        task: what is trained.
        settings: how.
        folder: of the checkpoint and of `log.jsonl`, one line each `log_every` steps.
        watch: called with step and mean logs where a line is written.

    Raises:
        InputError: the folder holds another training, or the loss stays not finite.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for module in task.modules.values():
        module.train()
    state = TrainingState.begin(task.modules, settings)
    state.read(folder, settings)
    log = _Log(folder / LOG_FILE, state.step, settings.log_every, watch)
    bad = 0
    while state.step < settings.steps:
        logs = _step(task, settings, state)
        bad = bad + 1 if not math.isfinite(logs["loss"]) else 0
        if bad == _GIVE_UP:
            raise InputError(
                folder, f"step {state.step}", "the loss is not finite any more",
                "lower the learning rate, or train in float32",
            )  # fmt: skip
        state.step += 1
        log.add(state.step, logs)
        if state.step % settings.checkpoint_every == 0 or state.step == settings.steps:
            state.write(folder, settings)
    return state


def _step(task: TrainingTask, settings: TrainerSettings, state: TrainingState) -> dict[str, float]:
    """One step of the optimiser; left out where loss or gradients are not finite."""
    for group in state.optimiser.param_groups:
        group["lr"] = settings.rate(state.step)
    state.optimiser.zero_grad(set_to_none=True)
    total: dict[str, float] = {}
    for part in range(settings.accumulate):
        found = task.loss(state.step, StepRandom.of(settings.seed, state.step, part))
        (found.loss / settings.accumulate).backward()
        for name, value in {"loss": float(found.loss.detach()), **found.logs}.items():
            total[name] = total.get(name, 0.0) + value / settings.accumulate
    parameters = state.parameters()
    if state.clipper is not None:
        norm = state.clipper.clip(parameters)
    else:
        assert not isinstance(settings.clip, str)  # else there is a clipper
        norm = float(torch.nn.utils.clip_grad_norm_(parameters, settings.clip))
    if math.isfinite(norm) and math.isfinite(total["loss"]):
        state.optimiser.step()
        for name, average in state.averages.items():
            average.update(state.modules[name])
    return {**total, "gradient": norm}


class _Log:
    """Means of the logs over some steps, as lines of JSON."""

    def __init__(self, path: Path, step: int, every: int, watch: Watch | None) -> None:
        self.path, self.every, self.watch = path, every, watch
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}
        self._since = time.perf_counter()
        lines = path.read_text().splitlines() if path.exists() else []
        # steps that a kill undid are logged again
        kept = [line for line in lines if json.loads(line)["step"] <= step]
        path.write_text("".join(f"{line}\n" for line in kept))

    def add(self, step: int, logs: dict[str, float]) -> None:
        for name, value in logs.items():
            if math.isfinite(value):
                self._sums[name] = self._sums.get(name, 0.0) + value
                self._counts[name] = self._counts.get(name, 0) + 1
        if step % self.every:
            return
        means = {name: self._sums[name] / self._counts[name] for name in self._sums}
        seconds = time.perf_counter() - self._since
        record = {"step": step, "seconds": round(seconds, 3), **means}
        with self.path.open("a") as stream:
            stream.write(json.dumps(record) + "\n")
        if self.watch is not None:
            self.watch(step, means)
        self._sums, self._counts, self._since = {}, {}, time.perf_counter()
