"""`recast recar assets | autoencoder | assemble`: the parts of a small image-to-3D model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import console_for


@dataclass(frozen=True)
class RecarAssets:
    """Make 3D assets to train autoencoders on: voxels, features and images of vehicles."""

    count: int
    """Number of assets; a folder of the same settings grows."""
    out: Path
    """Folder of the assets."""
    seed: Annotated[int, shared.SEED] = 0
    shape_every: int = 4
    """Interval of the assets that are other shapes, such as furniture and signs; 0 for none."""
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets

        console = console_for(False)
        record = AssetsRecord(seed=self.seed, shape_every=self.shape_every)
        with ProgressBar("assets", console) as progress:
            make_assets(self.out, self.count, record, workers=self.workers, progress=progress)
        console.print(f"wrote {self.out}: {self.count} assets", markup=False)


@dataclass(frozen=True)
class Autoencoder:
    """Train an autoencoder (structures or structured latents) or the image encoder."""

    part: tyro.conf.Positional[Literal["structure", "latent", "image"]]
    """Network to train."""
    assets: Path
    """Folder of `recast recar assets`."""
    out: Path
    """Folder of the training; the same command resumes. Networks are written to OUT/ckpts."""
    structure: Annotated[
        Path | None,
        shared.option("Folder of the trained structure autoencoder; the image encoder needs it."),
    ] = None
    steps: Annotated[
        int | None, shared.option("Number of optimiser steps.", "the shipped model's")
    ] = None
    seed: Annotated[int, shared.SEED] = 0
    threads: int = 1
    """Number of CPU threads."""

    def __call__(self) -> None:
        from recast.core.workers import use_threads
        from recast_tools.small_model.assemble import train_part

        use_threads(self.threads)
        train_part(
            self.part,
            self.assets,
            self.out,
            console_for(False),
            structure=self.structure,
            steps=self.steps,
            seed=self.seed,
        )


@dataclass(frozen=True)
class Assemble:
    """Combine trained parts to a model folder, and make the target cache for its flows."""

    assets: Path
    """Folder of `recast recar assets`."""
    structure: Path
    """Folder of the trained structure autoencoder."""
    latent: Path
    """Folder of the trained latent autoencoder."""
    image: Path
    """Folder of the trained image encoder."""
    model: Path
    """New model folder."""
    cache: Path
    """New target cache."""
    seed: Annotated[int, shared.SEED] = 0

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast_tools.small_model.assemble import assemble

        parts = {"structure": self.structure, "latent": self.latent, "image": self.image}
        console = console_for(False)
        with ProgressBar("assets", console) as progress:
            assemble(self.assets, parts, self.model, self.cache, seed=self.seed, progress=progress)
        console.print(f"wrote {self.model} and {self.cache}", markup=False)
