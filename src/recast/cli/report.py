"""`recast report` and `recast view`: runs on a page, in a browser, or as a file that plays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from recast.core.errors import InputError


@dataclass(frozen=True)
class Report:
    """Write the report of a run, or compare several runs.

    The result is one folder with index.html and everything that the page shows. It opens from disk.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folder made by `recast run`; with --compare two or more of them."""
    compare: bool = False
    """Write one page that sets the runs side by side. Differences are to the first run."""
    out: Path | None = None
    """Folder to write to. Default: RUN/report. With --compare it must be named."""

    def __call__(self) -> None:
        """Run the command."""
        if not self.compare and len(self.runs) != 1:
            raise InputError(
                "RUNS",
                "run folder",
                f"{len(self.runs)} given",
                "name one run, or add --compare to set several side by side",
            )
        if self.compare and self.out is None:
            raise InputError(
                "--out", "folder", "is missing", "name the folder for the page of --compare"
            )
        from rich.console import Console

        from recast.pipeline.report import compare_runs, report_run

        if self.compare:
            assert self.out is not None
            page = compare_runs(self.runs, self.out)
        else:
            page = report_run(self.runs[0], self.out)
        Console().print(f"wrote {page}", markup=False)


@dataclass(frozen=True)
class View:
    """Show logs, scenes, actors and rollouts in three dimensions, in a browser."""

    what: tyro.conf.Positional[tuple[Path, ...]]
    """A run folder; or rollout folders of one run; or a log with scenes, actors and rollouts of
    it; or scenes or actors alone."""
    host: str = "127.0.0.1"
    """Address to listen on. The default can be reached from this machine only; 0.0.0.0 lets
    everybody in your network look and run rollouts."""
    port: int = 8080
    """TCP port; the next free one if it is in use."""
    max_gaussians: int = 300_000
    """Maximum number of Gaussians that browsers get; the most important ones are kept."""
    out: Path = Path("scenarios")
    """Folder for the scenario files that are saved from the page."""
    replay: Path | None = None
    """Write this HTML file, which plays without a server, instead of opening a page."""
    replay_mb: float = 15.0
    """Maximum size of the replay in MB; fewer Gaussians make it smaller."""
    scenario: str | None = None
    """Scenario of the replay, such as cut-in-a. Default: the first one."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.view import replay_what, require_limits, serve_what, view_inputs

        require_limits(self.what, self.port, self.max_gaussians, self.replay, self.replay_mb)
        console, inputs = Console(), view_inputs(self.what)
        if self.replay is not None:
            replay_what(
                inputs, self.replay, self.replay_mb, self.max_gaussians, self.scenario, console
            )
        else:
            serve_what(inputs, self.host, self.port, self.max_gaussians, self.out, console)
