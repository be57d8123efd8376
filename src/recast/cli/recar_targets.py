"""`recast recar targets`: what the adaptation trains towards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.actor import MAX_VOXELS, SAMPLING_STEPS
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class Targets:
    """Make a pseudo-target of every vehicle of a set from its front, rear, left and right view.

    The same command resumes; finished targets stay.
    """

    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Vehicle set, in folders or shards."""
    model: Path
    """Model folder in the published layout (pipeline.json and ckpts/), or trellis (recast
    weights)."""
    out: Path
    """Cache folder; the same command resumes, and a larger set extends the cache."""
    seed: Annotated[int, shared.SEED] = 0
    limit: Annotated[int | None, shared.LIMIT] = None
    workers: Annotated[int, shared.WORKERS] = 1
    ray: Annotated[str | None, shared.RAY] = None
    image_encoder: Annotated[Path | None, shared.IMAGE_ENCODER] = None
    device: Annotated[str | None, shared.DEVICE] = None
    multi_image: Literal["stochastic", "multidiffusion"] = "stochastic"
    """Use of the four views: stochastic (one view at each step, in turn, as in the paper) or
    multidiffusion (the mean of all views at each step, at four times the cost)."""
    steps: Annotated[int | None, SAMPLING_STEPS] = None
    retries: int = 3
    """Number of further seeds to try if a structure is empty or too large."""
    max_voxels: Annotated[int | None, MAX_VOXELS] = None
    filter: Literal["agreement", "aesthetic", "none"] = "agreement"
    """Quality filter: agreement with the pictures, the Improved Aesthetic Predictor, or none."""
    heading: Literal["any", "+x"] = "any"
    """Heading of the model's vehicles: any (found from the pictures) or +x (models trained so)."""
    threshold: Annotated[
        float | None,
        shared.option(
            "Minimum score of a target; may be changed later.",
            "4.5 of the aesthetic predictor, 0.6 of the agreement",
            metavar="FLOAT",
        ),
    ] = None
    predictor: Annotated[
        Path | None,
        shared.option(
            "Weights of the aesthetic predictor (sac+logos+ava1-l14-linearMSE.pth), or aesthetic "
            "(recast weights).",
            metavar="PATH",
        ),
    ] = None
    clip: Annotated[
        Path | None,
        shared.option(
            "CLIP ViT-L/14 for the aesthetic predictor: a folder, or clip-vit-l14 (recast "
            "weights).",
            metavar="PATH",
        ),
    ] = None
    retry_failures: bool = False
    """Try again the vehicles that failed before."""
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from itertools import islice

        from recast.core.errors import InputError
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
            ("seed", self.seed, 0),
            ("limit", self.limit, 1),
            ("retries", self.retries, 0),
            ("max-voxels", self.max_voxels, 1),
            ("steps", self.steps, 1),
        ):
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
        console = console_for(self.json)
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
        if self.json:
            from recast.cli.rows.vehicles import target_rows

            print_json(target_rows(cache, target_statistics(cache)))
            return
        console.print(target_table(cache, target_statistics(cache)))
