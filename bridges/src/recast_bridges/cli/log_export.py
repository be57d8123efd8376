"""`recast log export`: scene bundles for AlpaSim's runtime."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.output import console_for


@dataclass(frozen=True)
class LogExport:
    """Write a log for another program: the scene bundle that AlpaSim's runtime reads.

    The bundle has poses, calibration, tracks and map; images come from `recast serve sensorsim`.
    """

    format: tyro.conf.Positional[Literal["alpasim"]]
    """Kind of the file: alpasim (a USDZ package)."""
    log: tyro.conf.Positional[str]
    """Log folder, or its address in object storage, such as s3://bucket/folder."""
    out: Path
    """File to write, NAME.usdz; must not exist."""
    scene: Annotated[
        str | None,
        shared.option(
            "Id under which `recast serve sensorsim` offers the scene.", "the log's name"
        ),
    ] = None
    map: bool = True
    """Write the map of the log into the bundle."""

    def __call__(self) -> None:
        from recast.logs import load_log
        from recast_bridges.alpasim import export_bundle

        told = export_bundle(load_log(self.log), self.out, self.scene, with_map=self.map)
        lines = [
            f"wrote {self.out}: scene {told.scene_id}, {told.cameras} cameras, "
            f"{told.tracks} tracks, {told.lanes} lanes"
        ]
        if told.tracks_left_out:
            lines.append(f"left out {told.tracks_left_out} tracks with a single label")
        if told.frames_left_out:
            lines.append(
                f"left out {told.frames_left_out} camera frames at the first pose of the ego"
            )
        for line in lines:
            console_for(False).print(line, markup=False, highlight=False, soft_wrap=True)
