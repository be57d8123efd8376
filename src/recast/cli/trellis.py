"""`recast trellis`: folders of image-to-3D models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Verify:
    """Check names, shapes, types and sizes of all models of a folder, without loading them."""

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


@dataclass(frozen=True)
class Export:
    """Write what generation needs of a model folder, in half precision, for handing on."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout: pipeline.json and ckpts/."""
    out: Path
    """Folder to write; must not exist."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.trellis.checkpoints import export_model

        export_model(self.folder, self.out)
        size = sum(path.stat().st_size for path in self.out.rglob("*") if path.is_file())
        Console().print(f"wrote {self.out}: {size / 1e6:.1f} MB", markup=False, soft_wrap=True)


@dataclass(frozen=True)
class Trellis:
    """Folders of image-to-3D models."""

    command: (
        Annotated[Verify, tyro.conf.subcommand("verify")]
        | Annotated[Export, tyro.conf.subcommand("export")]
    )

    def __call__(self) -> None:
        """Run the command."""
        self.command()
