"""A bar over the pictures of a set, with the time left."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

from recast.bars import Bars


class PictureProgress(Bars):
    """Draws in the terminal; pass the object itself as `progress`."""

    def __init__(self, what: str, console: Console | None = None) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
        )
        self._task = self._bars.add_task(what, total=None, left="")
        self._start: tuple[float, int] | None = None

    def __call__(self, done: int, total: int) -> None:
        """`done` of `total` pictures are finished; those of the first call cost nothing."""
        now = time.monotonic()
        if self._start is None:
            self._start = (now, done)
        started, skipped = self._start
        left = ""
        if skipped < done < total:
            left = time_left((now - started) / (done - skipped) * (total - done))
        self._bars.update(self._task, completed=done, total=total, left=left)


def time_left(seconds: float) -> str:
    """Such as "4:05 left" or "2:30:00 left"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} left" if hours else f"{minutes}:{rest:02d} left"
