"""What a person sees of long work: a bar over pictures, a bar and curves of a training."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from recast.core.errors import InputError
from recast.core.progress import Bars

_SHOWN = ("loss", "held_out", "gap", "gradient")


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
