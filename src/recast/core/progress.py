"""Progress: the callback of long functions, and bars on a terminal."""

from __future__ import annotations

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
        console: where to; the standard one if None.
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
        """Stop drawing."""
        self._bars.stop()
