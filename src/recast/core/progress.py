"""Progress: the callback of long functions, and bars on a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn

Progress = Callable[[int, int], None]
"""Called with the number of pieces that are done, and the number of all."""


def tell(progress: Progress | None, done: int, total: int) -> None:
    """Call a progress callback, if there is one."""
    if progress is not None:
        progress(done, total)


class Bars:
    """Draws while it is entered; a subclass adds tasks to `self._bars`.

    Args:
        console: console to draw on; the standard one if None.
    """

    def __init__(
        self, *columns: ProgressColumn, console: Console | None, disable: bool = False
    ) -> None:
        from rich import progress

        self._bars = progress.Progress(*columns, console=console, disable=disable)

    def __enter__(self) -> Self:
        """Start drawing."""
        self._bars.start()
        return self

    def __exit__(self, *fault: object) -> None:
        """Stop drawing; bars on which an error left nothing done disappear."""
        if any(fault) and not any(task.completed for task in self._bars.tasks):
            self._bars.live.transient = True
        self._bars.stop()


class ProgressBar(Bars):
    """A bar over equal pieces of work, with their number and the time left; itself a `Progress`.

    Args:
        what: name of the pieces, such as "pictures".
        console: console to draw on; the standard one if None.
        total: number of pieces; None until a call tells it.
    """

    def __init__(self, what: str, console: Console | None = None, total: int | None = None) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

        texts = TextColumn("  {task.description}"), TextColumn("{task.fields[left]}")
        super().__init__(texts[0], BarColumn(), MofNCompleteColumn(), texts[1], console=console)
        self._task = self._bars.add_task(what, total=total, left="")
        self._start: tuple[float, int] | None = None

    def __call__(self, done: int, total: int) -> None:
        """`done` of `total` pieces are finished; those of the first call cost nothing."""
        now = time.monotonic()
        if self._start is None:
            self._start = (now, done)
        started, skipped = self._start
        left = ""
        if skipped < done < total:
            left = time_left((now - started) / (done - skipped) * (total - done))
        self._bars.update(self._task, completed=done, total=total, left=left)

    def advance(self) -> None:
        """Count one more finished piece of the total that is known."""
        task = self._bars.tasks[0]
        self(int(task.completed) + 1, int(task.total or 0))


def time_left(seconds: float) -> str:
    """Such as "4:05 left" or "2:30:00 left"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} left" if hours else f"{minutes}:{rest:02d} left"
