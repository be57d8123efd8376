"""`recast recar assets | autoencoder | assemble`: what small models are built on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Assets:
    """Make 3D assets to train autoencoders on: voxels, features and pictures of vehicles."""

    count: int
    """Number of assets; a folder of the same settings grows."""
    out: Path
    """Folder."""
    seed: int = 0
    """Seed of everything random."""
    shape_every: int = 4
    """Every n-th asset is another shape: furniture, signs and the like; 0 for vehicles alone."""
    workers: int = 1
    """Processes; the files are the same for any number."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar.assets.build import AssetsRecord, make_assets
        from recast.recar.progress import PictureProgress

        console = Console()
        record = AssetsRecord(seed=self.seed, shape_every=self.shape_every)
        with PictureProgress("assets", console) as progress:
            make_assets(self.out, self.count, record, workers=self.workers, progress=progress)
        console.print(f"wrote {self.out}: {self.count} assets", markup=False)


@dataclass(frozen=True)
class Autoencoder:
    """Train the autoencoder of structures or of structured latents, or the image encoder."""

    part: tyro.conf.Positional[Literal["structure", "latent", "image"]]
    """Which."""
    assets: Path
    """Folder of `recast recar assets`."""
    out: Path
    """Folder of the training; a killed one goes on. The networks are written to OUT/ckpts."""
    structure: Path | None = None
    """Folder of the trained structure autoencoder, for the image encoder."""
    steps: int | None = None
    """Of the optimiser; as for the shipped model where not given."""
    seed: int = 0
    """Seed of everything random."""
    threads: int = 1
    """Of torch and of the rasterizer."""

    def __call__(self) -> None:
        """Run the command."""
        import torch
        from rich.console import Console

        from recast.recar.autoencoders.train import train_part
        from recast.splats import set_threads

        torch.set_num_threads(self.threads)
        set_threads(self.threads)
        train_part(
            self.part, self.assets, self.out, Console(),
            structure=self.structure, steps=self.steps, seed=self.seed,
        )  # fmt: skip


@dataclass(frozen=True)
class Assemble:
    """Put trained parts together: a model folder, and the cache its flows are trained on."""

    assets: Path
    """Folder of `recast recar assets`."""
    structure: Path
    """Folder of the trained structure autoencoder."""
    latent: Path
    """Folder of the trained latent autoencoder."""
    image: Path
    """Folder of the trained image encoder."""
    model: Path
    """Model folder to write; must not exist."""
    cache: Path
    """Target cache to write."""
    seed: int = 0
    """Of the latent flow's first weights."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.recar.autoencoders.assemble import assemble
        from recast.recar.progress import PictureProgress

        parts = {"structure": self.structure, "latent": self.latent, "image": self.image}
        console = Console()
        with PictureProgress("assets", console) as progress:
            assemble(self.assets, parts, self.model, self.cache, seed=self.seed, progress=progress)
        console.print(f"wrote {self.model} and {self.cache}", markup=False)
