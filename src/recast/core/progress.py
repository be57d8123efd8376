"""Bars on the terminal while a block runs."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress, ProgressColumn


class Bars:
    """Draws while it is entered; a subclass adds tasks to `self._bars`.

    Args:
        columns: of every bar.
        console: where to; the standard one if None.
        disable: draw nothing.
    """

    def __init__(
        self, *columns: ProgressColumn, console: Console | None, disable: bool = False
    ) -> None:
        self._bars = Progress(*columns, console=console, disable=disable)

    def __enter__(self) -> Self:
        """Start drawing."""
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop drawing."""
        self._bars.stop()
