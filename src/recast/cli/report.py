"""`recast report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from recast.errors import InputError


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
                "RUNS", "run folder", f"{len(self.runs)} given",
                "name one run, or add --compare to set several side by side",
            )  # fmt: skip
        if self.compare and self.out is None:
            raise InputError(
                "--out", "folder", "is missing", "name the folder for the page of --compare"
            )
        from rich.console import Console

        from recast.pipeline.compare import compare_runs
        from recast.pipeline.report import report_run

        if self.compare:
            assert self.out is not None
            page = compare_runs(self.runs, self.out)
        else:
            page = report_run(self.runs[0], self.out)
        Console().print(f"wrote {page}", markup=False)
