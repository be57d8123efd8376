"""`recast scenario`: what the controlled actor does, seen before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class List:
    """Print scenarios with their numbers, or check scenario files."""

    scenarios: tyro.conf.Positional[tuple[str, ...]] = ()
    """Scenarios such as cut-in-a, motions such as cut-in, or scenario files (.yaml); all that are
    built in where none is named."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.scenarios import list_scenarios

        list_scenarios(self.scenarios, Console())


@dataclass(frozen=True)
class Show:
    """Draw scenarios on the map of a log: where the ego starts, what the actor does, where a
    rollout would be cut."""

    log: tyro.conf.Positional[Path]
    """Log folder."""
    motion: tyro.conf.UseAppendAction[tuple[str, ...]]
    """Scenario such as cut-in-a, motion such as cut-in, or scenario file (.yaml). Give it several
    times for several, drawn below one another."""
    out: Path = Path("scenario.png")
    """Picture to write (PNG)."""
    track: str | None = None
    """Track to control. Default: the target of a synthetic log, else the first track."""
    steps: int = 160
    """Steps of 0.1 s that a rollout would be asked for."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.scenarios import show_scenarios

        show_scenarios(self.log, self.motion, self.track, self.out, self.steps, Console())


@dataclass(frozen=True)
class Scenario:
    """What the controlled actor does, seen before anything runs."""

    command: (
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
