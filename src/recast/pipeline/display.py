"""What `recast run` shows on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from recast.evaluation import COLUMNS


class FrameProgress:
    """A bar over the steps of a rollout, with the time left; call it after each step."""

    def __init__(self, console: Console, steps: int) -> None:
        self._bar = Progress(
            TextColumn("  steps"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._bar.add_task("steps", total=steps)

    def __call__(self) -> None:
        """One step more is done."""
        self._bar.advance(self._task)

    def __enter__(self) -> Self:
        """Start drawing."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop drawing."""
        self._bar.stop()


def results_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The headline metrics by method, from the `table` member of metrics.json."""
    headline = {name: column for name, column in COLUMNS.items() if column.headline}
    table = Table(title="closed loop", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("method", "run", "failed", "cut"):
        table.add_column(heading, no_wrap=True)
    for column in headline.values():
        table.add_column(f"{column.label} {column.unit}", no_wrap=True)
    for row in rows:
        values = [row["means"][name] for name in headline]
        table.add_row(
            row["method"],
            *(str(row[key]) for key in ("rollouts", "failed", "cut")),
            *("n/a" if value is None else f"{value:.2f}" for value in values),
        )
    return table
