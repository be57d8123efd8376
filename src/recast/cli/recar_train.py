"""`recast recar assets | autoencoder | assemble | train`: small models, and the adaptation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.output import console_for


@dataclass(frozen=True)
class Assets:
    """Make 3D assets to train autoencoders on: voxels, features and pictures of vehicles."""

    count: int
    """Number of assets; a folder of the same settings grows."""
    out: Path
    """Folder of the assets."""
    seed: Annotated[int, shared.SEED] = 0
    shape_every: int = 4
    """Interval of the assets that are other shapes, such as furniture and signs; 0 for none."""
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from recast.core.progress import ProgressBar
        from recast.recar.training.asset_synthesis import AssetsRecord, make_assets

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
        from recast.recar.training.assemble import train_part

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
        from recast.core.progress import ProgressBar
        from recast.recar.training.assemble import assemble

        parts = {"structure": self.structure, "latent": self.latent, "image": self.image}
        console = console_for(False)
        with ProgressBar("assets", console) as progress:
            assemble(self.assets, parts, self.model, self.cache, seed=self.seed, progress=progress)
        console.print(f"wrote {self.model} and {self.cache}", markup=False)


@dataclass(frozen=True)
class Train:
    """Train the flows of an image-to-3D model towards pseudo-targets; the same command resumes.

    On several GPUs: torchrun --nproc-per-node 2 -m recast.cli.main recar train ...
    """

    model: Path
    """Model folder to start from (published layout), recast-mini (in the package) or trellis
    (recast weights)."""
    targets: Path
    """Cache of pseudo-targets, from `recast recar targets`."""
    set: Path
    """Vehicle set with the pictures, in folders or shards; or a folder of training assets."""
    out: Path
    """Folder of the new model; the same command resumes."""
    stage: Annotated[
        Literal["1", "2", "base", "base-2", "mini-1", "mini-2"] | None,
        shared.option(
            "Stage of the paper: 1 (vehicles) or 2 (perturbed pictures); of the small model: base, "
            "base-2, mini-1 or mini-2."
        ),
    ] = None
    config: Annotated[
        Path | None,
        shared.option(
            'JSON file with all settings of a stage, or "preset" and the changes; instead of '
            "--stage."
        ),
    ] = None
    flow: Annotated[
        tyro.conf.UseAppendAction[tuple[Literal["structure", "latent"], ...]],
        shared.option(
            "Flow to train in this process; the model is written after the last flow.", "both"
        ),
    ] = ()
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    tensorboard: bool = False
    """Also write TensorBoard curves to OUT/tensorboard."""

    def __call__(self) -> None:
        from rich.console import Console

        from recast.recar.training.stage import train_stage
        from recast.recar.training.stage_config import chosen_stage
        from recast.recar.training.stage_parts import StageRequest
        from recast.training.loop import Processes
        from recast.weights import located

        config = chosen_stage(self.stage, self.config)
        request = StageRequest(
            config,
            located("--model", self.model),
            self.targets,
            self.set,
            self.out,
            located("--image-encoder", self.image_encoder),
            self.device,
            self.tensorboard,
            self.flow,
        )
        processes = Processes.started()
        left = train_stage(request, processes=processes)
        said = f"{self.out}: {', '.join(left)} still to train" if left else f"wrote {self.out}"
        Console(quiet=not processes.first).print(said, markup=False, soft_wrap=True)
