"""`recast view`: scenes, actors and rollouts in a browser, or as a file that plays by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


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
