"""`recast recar screen`: a person looks at pseudo-targets and decides."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import console_for


@dataclass(frozen=True)
class Screen:
    """Accept, reject or flip pseudo-targets in the browser with single keys.

    Each decision is written to CACHE/screening.json at once; the same command resumes.
    """

    cache: tyro.conf.Positional[Path]
    """Cache of pseudo-targets; it may be unfinished."""
    set: Annotated[
        Path | None,
        shared.option(
            "Vehicle set of the cache, in folders or shards; its pictures are shown larger.",
            metavar="PATH",
        ),
    ] = None  # fmt: skip
    port: int = 8765
    """Port of the page, which only this machine can open; 0 takes a free port."""

    def __call__(self) -> None:
        """Run the command."""
        from recast.recar.screening.server import ScreeningServer
        from recast.recar.screening.service import ScreeningService
        from recast.recar.shards import open_set
        from recast.recar.targets import TargetCache

        cache = TargetCache.open(self.cache, complete=False)
        service = ScreeningService(cache, None if self.set is None else open_set(self.set))
        console = console_for(False)
        with ScreeningServer(service, self.port) as server:
            console.print(f"{len(service.catalogue)} targets: open {server.url}", markup=False)
            console.print("Ctrl-C ends; every decision is saved when it is made", markup=False)
            with suppress(KeyboardInterrupt):
                server.serve_forever()
        console.print(f"{self.cache}: {service.summary()}", markup=False, highlight=False)
