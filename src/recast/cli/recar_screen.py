"""`recast recar screen`: a person looks at pseudo-targets and decides."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Screen:
    """Accept, reject or flip pseudo-targets on a page in the browser, by single keys.

    Every decision is in CACHE/screening.json at the key press; the same command goes on where it
    was left.
    """

    cache: tyro.conf.Positional[Path]
    """Cache of pseudo-targets; may still be in the making."""
    set: Path | None = None
    """The set it was made from, in folders or shards, to show its pictures larger."""
    port: int = 8765
    """Of the page, which only this machine can open; 0 takes any that is free."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar.screening.server import ScreeningServer
        from recast.recar.screening.service import ScreeningService
        from recast.recar.shards import open_set
        from recast.recar.targets import TargetCache

        cache = TargetCache.open(self.cache, complete=False)
        service = ScreeningService(cache, None if self.set is None else open_set(self.set))
        console = Console()
        with ScreeningServer(service, self.port) as server:
            console.print(f"{len(service.catalogue)} targets: open {server.url}", markup=False)
            console.print("Ctrl-C ends; every decision is saved when it is made", markup=False)
            with suppress(KeyboardInterrupt):
                server.serve_forever()
        console.print(f"{self.cache}: {service.summary()}", markup=False, highlight=False)
