"""`recast report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Report:
    """Write the report of a run anew: one self-contained folder with index.html."""

    run: tyro.conf.Positional[Path]
    """Run folder made by `recast run`."""
    out: Path | None = None
    """Folder to write to; RUN/report where none is named."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.report import report_run

        Console().print(f"wrote {report_run(self.run, self.out)}")
