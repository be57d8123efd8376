"""What is trained and how: the task, its settings, its log, and what a person sees of it."""

from __future__ import annotations

import importlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import torch
from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.core.files import disk_errors, parse_json, read_text, write_text
from recast.core.progress import Bars
from recast.core.records import Record, validation_error

_WHOLE = 2**32 - 1  # a part number that no part has
Share = Annotated[float, Field(ge=0, lt=1)]
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


class TrainerSettings(Record):
    """Optimiser, schedule and bookkeeping of one training.

    Attributes:
        steps: number of steps of the optimiser.
        lr: peak learning rate of AdamW.
        schedule: learning rate schedule: constant after the warm-up, or a cosine down to 1 % of the
            peak.
        warmup: number of steps over which the rate rises linearly.
        betas, weight_decay: betas and weight decay of AdamW.
        ema_decay: decay of the moving average of the weights; None keeps none.
        clip: norm to which gradients are clipped; "adaptive" as the published trainer does.
        accumulate: number of batches a step.
        seed: seed of everything random.
        checkpoint_every: number of steps between checkpoints.
        log_every: number of steps between lines of the log.
    """

    steps: int = Field(ge=1)
    lr: FiniteFloat = Field(gt=0)
    schedule: Literal["constant", "cosine"] = "constant"
    warmup: int = Field(default=0, ge=0)
    betas: tuple[Share, Share] = (0.9, 0.999)
    weight_decay: FiniteFloat = Field(default=0.0, ge=0)
    ema_decay: Share | None = None
    clip: Annotated[FiniteFloat, Field(gt=0)] | Literal["adaptive"] = "adaptive"
    accumulate: int = Field(default=1, ge=1)
    seed: int = Field(default=0, ge=0)
    checkpoint_every: int = Field(default=500, ge=1)
    log_every: int = Field(default=50, ge=1)

    def same_course(self, other: TrainerSettings) -> bool:
        """Whether both take the same steps, as far as both go.

        How often is written does not matter, nor does where a constant schedule ends.
        """
        free = {"checkpoint_every", "log_every"}
        if self.schedule == "constant":
            free.add("steps")
        return self.model_dump(exclude=free) == other.model_dump(exclude=free)

    def rate(self, step: int) -> float:
        """Learning rate of step number `step`, from 0."""
        warm = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        if self.schedule == "constant":
            return self.lr * warm
        progress = min(1.0, step / self.steps)
        return self.lr * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def overridden(start: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with members replaced; objects member by member."""
    merged = dict(start)
    for name, value in changes.items():
        old = merged.get(name)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[name] = overridden(old, value) if both else value  # type: ignore[arg-type]
    return merged


@dataclass
class Means:
    """Sums and counts by name of the values that were finite.

    A checkpoint keeps them, so that the lines of a resumed log are those of an uninterrupted one.
    """

    sums: dict[str, float] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)

    def add(self, values: Mapping[str, float]) -> None:
        """Count values in; one that is not finite only makes its name known."""
        for name, value in values.items():
            known = math.isfinite(value)
            self.sums[name] = self.sums.get(name, 0.0) + (value if known else 0.0)
            self.counts[name] = self.counts.get(name, 0.0) + known

    def means(self) -> dict[str, float]:
        """By name; NaN where nothing finite was seen."""
        return {
            name: total / self.counts[name] if self.counts[name] else math.nan
            for name, total in self.sums.items()
        }


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
            disable=not console.is_terminal,
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
        if not self.console.is_terminal:
            self.console.print(f"{self.what} {step}/{self.steps}  {shown}", markup=False)
        if self.writer is not None:
            for name, value in {**values, "rate": rate}.items():
                if math.isfinite(value):
                    self.writer.add_scalar(f"{self.what}/{name}", value, step)

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
