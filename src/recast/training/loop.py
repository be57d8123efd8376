"""The training loop, in one process or those of torchrun: its task, its steps, its log and bars.

The steps are the same, interrupted or not.
"""

from __future__ import annotations

import atexit
import importlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Task, TextColumn, TimeRemainingColumn
from torch import Tensor, nn

from recast.core.diagnostics import Bars
from recast.core.errors import InputError
from recast.core.files import alone_in, disk_errors, parse_json, read_text, write_text
from recast.core.records import validation_error
from recast.training.state import Means, TrainerSettings, TrainingState, steps_done

Watch = Callable[[int, dict[str, float]], None]
Probe = Callable[[], Mapping[str, float]]
AfterStep = Callable[[TrainingState], None]
_GIVE_UP = 20  # steps in a row whose loss or gradient is not finite
_WHOLE = 2**32 - 1  # a part number that no part has
LOG_FILE = "log.jsonl"
_LINE: TypeAdapter[dict[str, int | float]] = TypeAdapter(dict[str, int | float])
_SHOWN = ("loss", "held_out", "gap", "gradient")


@dataclass(frozen=True)
class StepRandom:
    """All randomness of one step: it depends on seed, step and part alone, so a run can resume.

    Attributes:
        numpy: generator for choices of data.
        torch: generator for noise, on the CPU.
        part, parts: index of this part of the step's batch, and number of all its parts; parts are
            accumulated one after another, or by several processes at once.
        seed, step: seed and step from which everything is derived.
    """

    numpy: np.random.Generator
    torch: torch.Generator
    part: int = 0
    parts: int = 1
    seed: int = 0
    step: int = 0

    @staticmethod
    def of(seed: int, step: int, part: int = 0, parts: int = 1) -> StepRandom:
        """The randomness of a step, or of one of its accumulated parts."""
        rng = np.random.default_rng([seed, step, part])
        noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
        return StepRandom(rng, noise, part, parts, seed, step)

    def whole(self) -> np.random.Generator:
        """For choices about the step's whole batch: the same for all its parts."""
        return np.random.default_rng([self.seed, self.step, _WHOLE])


@dataclass(frozen=True)
class StepLoss:
    """Loss of one batch.

    Attributes:
        loss: scalar with its graph.
        logs: values to show and write, by name; those that are not finite are left out of means.
            Several processes must give the same names in each step.
    """

    loss: Tensor
    logs: Mapping[str, float] = field(default_factory=dict)


class TrainingTask(Protocol):
    """What is trained, and on what."""

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """The networks whose parameters are trained, by name."""
        ...

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """Loss of the batch of a step; the same step and randomness give the same loss."""
        ...


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


class TrainingLog:
    """Appends to a `log.jsonl`.

    Args:
        path: path of the file; lines of steps after `step`, which a kill undid, are dropped.
        step: number of steps done so far.
        every: number of steps from line to line.
        pending: means since the last line.
    """

    def __init__(self, path: Path, step: int, every: int, pending: Means) -> None:
        self.path, self.every, self.pending = path, every, pending
        self._since = time.perf_counter()
        kept = [line for line in read_log_lines(path) if line["step"] <= step]
        write_text(path, "".join(f"{json.dumps(line)}\n" for line in kept))

    def due(self, step: int) -> bool:
        """Whether a line ends with this step."""
        return step % self.every == 0

    def write(self, step: int, extra: Mapping[str, float]) -> dict[str, float]:
        """Write the line of a step, with further values; gives back what it says.

        `seconds` are those since the last line, or since the training was resumed.
        """
        values = {**self.pending.means(), **extra}
        values = {name: value for name, value in values.items() if math.isfinite(value)}
        seconds = round(time.perf_counter() - self._since, 3)
        with disk_errors(self.path), self.path.open("a") as stream:
            stream.write(json.dumps({"step": step, "seconds": seconds, **values}) + "\n")
        self.pending.sums.clear()
        self.pending.counts.clear()
        self._since = time.perf_counter()
        return values


def read_log_lines(path: Path) -> list[dict[str, float]]:
    """The lines of a log, but for a last one that a kill cut short; none where there is no log.

    Raises:
        InputError: another line cannot be read, or is no line of a log.
    """
    whole = read_text(path).split("\n")[:-1] if path.exists() else []
    return [_line(f"{path}: line {number}", text) for number, text in enumerate(whole, 1)]


def _line(where: str, text: str) -> dict[str, float]:
    mend = "remove the line"
    try:
        values = _LINE.validate_python(parse_json(where, text))
    except ValidationError as error:
        raise validation_error(where, error, mend) from None
    if not {"step", "seconds"} <= values.keys():
        raise InputError(where, "line", "lacks step or seconds", mend)
    return values


class TrainingBar(Bars):
    """A bar with the latest means; where there is no terminal, a line for each line of the log.

    Args:
        what: name of what is trained.
        steps: number of steps in all.
        console: console to write to.
        writer: TensorBoard writer, see `tensorboard_writer`.
    """

    def __init__(self, what: str, steps: int, console: Console, writer: Any = None) -> None:
        self.what, self.steps, self.console, self.writer = what, steps, console, writer
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[means]}"),
            console=console,
        )
        self._task = self._bars.add_task(what, total=steps, means="")

    def step(self, done: int) -> None:
        """So many steps are done."""
        self._bars.update(self._task, completed=done)

    def means(self, step: int, values: Mapping[str, float], rate: float) -> None:
        """A line of the log was written.

        Args:
            step: step that the line ends with.
            values: values that the line holds.
            rate: learning rate.
        """
        shown = "  ".join(f"{name} {values[name]:.4g}" for name in _SHOWN if name in values)
        self._bars.update(self._task, means=shown)
        if self._bars.disable:
            self.console.print(f"{self.what} {step}/{self.steps}  {shown}", markup=False)
        if self.writer is not None:
            for name, value in {**values, "rate": rate}.items():
                if math.isfinite(value):
                    self.writer.add_scalar(f"{self.what}/{name}", value, step)

    def _conclude(self, tasks: Sequence[Task]) -> None:
        """Nothing more: the lines of the log were shown."""

    def __exit__(self, *error: object) -> None:
        """Stop drawing, and write the last curves."""
        super().__exit__(*error)
        if self.writer is not None:
            self.writer.flush()


def tensorboard_writer(folder: Path) -> Any:
    """A writer of curves into a folder.

    Raises:
        InputError: tensorboard is not installed.
    """
    try:
        module: Any = importlib.import_module("torch.utils.tensorboard")
    except ImportError:
        raise InputError(
            "`tensorboard`",
            "package",
            "tensorboard is not installed",
            "pip install tensorboard, or leave the option out: log.jsonl holds the same figures",
        ) from None
    return module.SummaryWriter(folder)
