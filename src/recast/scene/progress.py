"""What training tells about itself while it runs, and a display for the terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text


@dataclass(frozen=True)
class TrainingStatus:
    """A moment of a training run.

    Attributes:
        phase: what is being done: "initialise", "train", "evaluate", "done".
        iteration, iterations: steps done, and of how many.
        gaussians: how many there are.
        most_gaussians: limit of Gaussians; None before it is known.
        limited: whether the limit kept any from being added.
        loss, psnr: running means over the latest training views; None before the first.
        held_out_psnr: of the last periodic evaluation in dB; None before the first.
        iterations_per_second: over the latest steps.
        seconds_left: estimate to the end of training.
    """

    phase: str
    iteration: int
    iterations: int
    gaussians: int = 0
    most_gaussians: int | None = None
    limited: bool = False
    loss: float | None = None
    psnr: float | None = None
    held_out_psnr: float | None = None
    iterations_per_second: float | None = None
    seconds_left: float | None = None


ProgressCallback = Callable[[TrainingStatus], None]


class TrainingDisplay:
    """A live line with a bar; pass the object itself as `progress` to `train_scene`.

    >>> from recast.scene import train_scene
    >>> with TrainingDisplay() as display:                      # doctest: +SKIP
    ...     train_scene(log, out, config, progress=display)
    """

    def __init__(self, console: Console | None = None) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        self._task = self._bar.add_task("scene", total=None)
        self._live = Live(console=console, refresh_per_second=4)
        self._live.update(self._bar)

    def __call__(self, status: TrainingStatus) -> None:
        """Show a status."""
        self._bar.update(
            self._task,
            description=f"scene: {status.phase}",
            total=status.iterations,
            completed=status.iteration,
        )
        self._live.update(Group(self._bar, Text("  " + describe(status), style="dim")))

    def __enter__(self) -> Self:
        """Start drawing."""
        self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop drawing and leave the last state on the screen."""
        self._live.stop()
        if not self._live.console.is_interactive:  # Live ends such a line only where it redraws
            self._live.console.print()


def describe(status: TrainingStatus) -> str:
    """One line of figures: those that are known."""
    parts = [f"{status.gaussians:,} Gaussians"] if status.gaussians else []
    if status.limited:
        parts.append(f"limit of {status.most_gaussians:,} met")
    if status.loss is not None:
        parts.append(f"loss {status.loss:.4f}")
    if status.psnr is not None:
        parts.append(f"train {status.psnr:.2f} dB")
    if status.held_out_psnr is not None:
        parts.append(f"held out {status.held_out_psnr:.2f} dB")
    if status.iterations_per_second is not None:
        parts.append(f"{status.iterations_per_second:.1f} it/s")
    if status.seconds_left is not None:
        minutes, seconds = divmod(round(status.seconds_left), 60)
        parts.append(f"{minutes}:{seconds:02d} left")
    return ", ".join(parts)
