"""`recast trellis`: folders of image-to-3D models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class TrellisVerify:
    """Check names, shapes, types and sizes of the weights in a model folder."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout (pipeline.json and ckpts/), recast-mini (in the package) or
    trellis (recast weights)."""
    values: bool = False
    """Read every tensor, and check that all values are finite."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.trellis.checkpoints import (
            check_details,
            check_table,
            first_fault,
            verify_checkpoint,
        )
        from recast.weights import located

        folder = located("--model", self.folder)
        checks = verify_checkpoint(folder, values=self.values)
        console = console_for(self.json)
        if self.json:
            from recast.cli.rows.vehicles import check_rows

            print_json(check_rows(checks))
        else:
            console.print(check_table(checks, folder))
        for check in checks:
            for line in check_details(check):
                console.print(line, markup=False, highlight=False, soft_wrap=True)
        fault = first_fault(checks)
        if fault is not None:
            raise fault


@dataclass(frozen=True)
class TrellisExport:
    """Write the weights that generation needs, in half precision, to a smaller model folder."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder in the published layout (pipeline.json and ckpts/), recast-mini (in the package) or
    trellis (recast weights)."""
    out: Path
    """New model folder."""

    def __call__(self) -> None:
        from recast.trellis.checkpoints import export_model
        from recast.weights import located

        export_model(located("--model", self.folder), self.out)
        size = sum(path.stat().st_size for path in self.out.rglob("*") if path.is_file())
        console_for(False).print(
            f"wrote {self.out}: {size / 1e6:.1f} MB", markup=False, soft_wrap=True
        )


Trellis = shared.group(
    "trellis",
    "Check or export model folders of the image-to-3D model.",
    {"verify": TrellisVerify, "export": TrellisExport},
)
