"""What a person sees of what runs: records of the `recast` loggers, progress and bars.

Libraries only log, under the names of their modules. A program decides once where to, with `begin`;
worker processes are told the same.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from recast.core.errors import printable
from recast.core.files import disk_errors

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn, Task


_LOGGER = logging.getLogger("recast")
_LINE = "%(asctime)s %(levelname)s %(process)d %(name)s: %(message)s"


@dataclass(frozen=True)
class Diagnostics:
    """Where records go.

    Attributes:
        verbose: whether they go to standard error, with the tracebacks of errors that users caused.
        file: file that they are appended to, or None.
        warnings: whether warnings and errors go to standard error even if not `verbose`.
    """

    verbose: bool = False
    file: Path | None = None
    warnings: bool = False


_current = Diagnostics()


def begin(wanted: Diagnostics) -> None:
    """Send all records there from now on, and nowhere else.

    Raises:
        InputError: the file cannot be written.
    """
    global _current
    if wanted.file is not None:  # other processes may work in another folder
        wanted = replace(wanted, file=wanted.file.absolute())
    handlers: list[logging.Handler] = []
    if wanted.verbose or wanted.warnings:
        handlers.append(logging.StreamHandler())
        handlers[0].setLevel(logging.DEBUG if wanted.verbose else logging.WARNING)
    if wanted.file is not None:
        with disk_errors(wanted.file):
            # Several processes append to it: each record is one write.
            handlers.append(
                logging.FileHandler(wanted.file, encoding="utf-8", errors="backslashreplace")
            )
    for old in list(_LOGGER.handlers):
        _LOGGER.removeHandler(old)
        old.close()
    for handler in handlers or [logging.NullHandler()]:
        handler.setFormatter(_OneLine(_LINE))
        _LOGGER.addHandler(handler)
    _LOGGER.setLevel(min((handler.level or logging.DEBUG for handler in handlers), default=0))
    logging.raiseExceptions = not handlers  # a full disk below the file ends no run
    _current = wanted


def show_warnings() -> None:
    """Send warnings and errors to standard error, too: a server has nobody else to tell them."""
    begin(replace(_current, warnings=True))


def current() -> Diagnostics:
    """Where records go, for `begin` in another process."""
    return _current


class _OneLine(logging.Formatter):
    """Messages hold names from files; a record is a line, but for its traceback."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        record.message = printable(record.message)
        return super().formatMessage(record)


Progress = Callable[[int, int], None]
"""Called with the number of pieces that are done, and the number of all."""


def tell(progress: Progress | None, done: int, total: int) -> None:
    """Call a progress callback, if there is one."""
    if progress is not None:
        progress(done, total)


def draws(console: Console) -> bool:
    """Whether bars can move on a console; in a file or a pipe a bar is only clutter."""
    return console.is_interactive or console.is_jupyter


class Bars:
    """Draws while it is entered; a subclass adds tasks to `self._bars`.

    Where no bar can move, a task that got somewhere is one plain line at the end.

    Args:
        console: console to draw on; the standard one if None.
    """

    def __init__(self, *columns: ProgressColumn, console: Console | None) -> None:
        from rich import get_console, progress

        console = console or get_console()
        self._bars = progress.Progress(*columns, console=console, disable=not draws(console))

    def __enter__(self) -> Self:
        """Start drawing."""
        self._bars.start()
        return self

    def __exit__(self, *fault: object) -> None:
        """Stop drawing; bars on which nothing was done disappear."""
        begun = [task for task in self._bars.tasks if task.completed]
        self._bars.live.transient = not begun
        self._bars.stop()
        if self._bars.disable:
            self._conclude(begun)

    def _conclude(self, tasks: Sequence[Task]) -> None:
        for task in tasks:
            said = f"  {task.description} {task.completed:g}/{task.total or task.completed:g}"
            self._bars.console.print(said, markup=False, highlight=False)


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
