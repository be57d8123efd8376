"""`recast trellis`: folders of image-to-3D models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Trellis:
    """Check names, shapes, types and sizes of all models of a folder, without loading them."""

    # tyro makes no subcommand of a single choice
    task: Annotated[tyro.conf.Positional[Literal["verify"]], tyro.conf.arg(metavar="verify")]
    """What to do."""
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout: pipeline.json and ckpts/."""
    values: bool = False
    """Read every tensor too, and check that it is finite."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.trellis.checkpoints import (
            check_details,
            check_table,
            first_fault,
            verify_checkpoint,
        )

        checks = verify_checkpoint(self.folder, values=self.values)
        console = Console()
        console.print(check_table(checks, self.folder))
        for check in checks:
            for line in check_details(check):
                console.print(line, markup=False, highlight=False, soft_wrap=True)
        fault = first_fault(checks)
        if fault is not None:
            raise fault
