"""`recast scene import`: bring in a street that another program made.

Checkpoints of other methods are imported by the commands of recast-bridges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from recast.cli import shared
from recast.cli.output import console_for

if TYPE_CHECKING:
    from recast.scene.imported import ImportRecord

WORLD_FROM_SCENE = shared.option(
    "Text file with a 4x4 matrix or an offset from the scene's coordinates to the log's world."
)


@dataclass(frozen=True)
class GaussiansFile:
    """Import a file of Gaussians as a static background: 3DGS PLY, glTF, SPZ or OpenUSD text."""

    background: tyro.conf.Positional[Path]
    """File (.ply, .glb, .spz or .usda)."""
    log: Path
    """Log folder of the drive."""
    out: Path
    """Scene folder to write; must not exist."""
    world_from_file: Annotated[
        Path | None,
        shared.option(
            "Text file with a 4x4 matrix (it may scale) or an offset from the file's coordinates "
            "to the log's world. GLB and SPZ are first turned to x forward, y left, z up.",
            "the same coordinates",
        ),
    ] = None
    sky: Annotated[
        Path | None,
        shared.option(
            "Equirectangular sky image, as `recast scene export` writes it.", "a black sky"
        ),
    ] = None

    def __call__(self) -> None:
        from recast.scene.imported import import_gaussians

        run_import(import_gaussians, **vars(self))


def run_import(make: Callable[..., ImportRecord], log: Path, out: Path, **options: Any) -> None:
    """Call an importer with a command's options; the first is its file."""
    from recast.logs import read_log

    path = options.pop(next(iter(options)))
    tell_import(make(path, read_log(log), out, **options), out)


def tell_import(record: ImportRecord, out: Path) -> None:
    """Print what an import made."""
    from recast.cli.rows.logs import import_lines

    console = console_for(False)
    for line, style in import_lines(record):
        console.print(line, style=style, markup=False, highlight=False)
    console.print(f"wrote {out}", markup=False)
