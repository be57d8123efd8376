"""`recast recar targets`: what the adaptation trains towards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Targets:
    """Make the pseudo-target of every vehicle of a set from its front, rear, left and right view.

    The command can be stopped and repeated at any time; finished targets stay.
    """

    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Vehicle set, in folders or shards."""
    model: Path
    """Model folder in the published layout (pipeline.json and ckpts/), or trellis (see recast
    weights)."""
    out: Path
    """Cache folder; new, or one of the same model and options, which is finished or grows."""
    seed: int = 0
    """From which the seed of every vehicle is derived."""
    limit: int | None = None
    """Only the first so many vehicles of the set."""
    workers: int = 1
    """Processes, or actors of the cluster; the files are the same for any number."""
    ray: str | None = None
    """Address of a Ray cluster (auto, ray://HOST:10001), or local. Needs the extra distributed."""
    image_encoder: Path | None = None
    """Weights of the published image encoder, where the model folder has none; or dinov2 (see
    recast weights)."""
    device: str | None = None
    """Such as cpu or cuda:1; CUDA where there is some, one device a process in turn."""
    multi_image: Literal["stochastic", "multidiffusion"] = "stochastic"
    """How the four views are used: one a sampling step in turn, as the paper; or the mean of all
    at every step, at four times the cost."""
    steps: int | None = None
    """Sampling steps of both stages; as the model says where not given."""
    retries: int = 3
    """Further seeds for a structure that is empty or too large."""
    max_voxels: int | None = None
    """Most active voxels; 8 R^2 where not given, 32,768 of the published model."""
    filter: Literal["agreement", "aesthetic", "none"] = "agreement"
    """Quality filter: agreement with the pictures, or the Improved Aesthetic Predictor."""
    heading: Literal["any", "+x"] = "any"
    """Where vehicles of the model look: any way, as those of the published models, found by the
    pictures; or along +x, as those of small models that were trained so."""
    threshold: float | None = None
    """Least score of a target that is used, 4.5 of the aesthetic predictor and 0.6 of the
    agreement where not given; may be changed later without making targets anew."""
    predictor: Path | None = None
    """Weights of the aesthetic predictor: sac+logos+ava1-l14-linearMSE.pth, or aesthetic (see
    recast weights)."""
    clip: Path | None = None
    """Folder of CLIP ViT-L/14 as Hugging Face has it, for the aesthetic predictor; or clip-vit-l14
    (see recast weights)."""
    retry_failures: bool = False
    """Try again what failed before."""

    def __call__(self) -> None:
        """Run the command."""
        from itertools import islice

        from rich.console import Console

        from recast.errors import InputError
        from recast.recar.progress import PictureProgress
        from recast.recar.shards import open_set
        from recast.recar.targets import (
            FilterSettings,
            ModelSource,
            TargetSettings,
            build_targets,
            target_statistics,
            target_table,
        )
        from recast.trellis.checkpoints import read_pipeline
        from recast.weights import located

        for name, value, least in (
            ("seed", self.seed, 0), ("limit", self.limit, 1), ("retries", self.retries, 0),
            ("max-voxels", self.max_voxels, 1), ("steps", self.steps, 1),
        ):  # fmt: skip
            if value is not None and value < least:
                raise InputError(f"--{name}", "value", f"is {value}", f"give {least} or more")
        vehicles = open_set(self.set)
        model = located("--model", self.model)
        pipeline = read_pipeline(model)
        settings = TargetSettings(
            seed=self.seed,
            mode=self.multi_image,
            structure=pipeline.sparse_structure_settings.merged(steps=self.steps),
            latent=pipeline.slat_settings.merged(steps=self.steps),
            retries=self.retries,
            max_voxels=self.max_voxels,
            heading=self.heading,
            filter=FilterSettings(
                kind=self.filter,
                threshold=self.threshold,
                predictor=located("--predictor", self.predictor),
                clip=located("--clip", self.clip),
            ),
        )
        console = Console()
        with PictureProgress("targets", console) as progress:
            cache = build_targets(
                vehicles,
                ModelSource(model, located("--image-encoder", self.image_encoder), self.device),
                self.out,
                settings,
                workers=self.workers,
                ray=self.ray,
                identities=None
                if self.limit is None
                else set(islice(vehicles.identities, self.limit)),
                retry_failures=self.retry_failures,
                progress=progress,
            )
        console.print(target_table(cache, target_statistics(cache)))
