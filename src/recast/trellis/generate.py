"""The whole way from crops to vehicles: several in one batch, each with its own seed."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from recast.trellis.draws import draw_structures
from recast.trellis.flow import Condition, MultiImageMode, SamplerSettings
from recast.trellis.generation import GeneratedVehicle, Generation, GenerationLimits
from recast.trellis.image_to_3d import ImageTo3D, Progress, RgbaImage
from recast.trellis.stopwatch import Stopwatch


def generate(
    model: ImageTo3D,
    vehicles: Sequence[Sequence[RgbaImage]],
    seeds: Sequence[int],
    *,
    names: Sequence[str] | None = None,
    mode: MultiImageMode = "stochastic",
    structure: SamplerSettings | None = None,
    latent: SamplerSettings | None = None,
    limits: GenerationLimits | None = None,
    progress: Progress | None = None,
) -> Generation:
    """Generate vehicles, all in one batch.

    Every vehicle has a random stream of its own, so that it comes out the same alone and in
    company, up to rounding. The stream is that of the published pipeline for one sample: the noise
    of the structure, then that of the latent, both drawn on the CPU.

    Args:
        model: see `ImageTo3D`.
        vehicles: for each the views of it, (H, W, 4) uint8 RGBA with straight alpha; the same
            number of views for all. The order of the views matters, see `Condition`.
        seeds: one for each vehicle.
        names: what messages call them; "crop 1", ... where not given.
        mode: how several views are used, see `Condition`.
        structure, latent: samplers; those of the checkpoint where not given.
        limits: see `GenerationLimits`.
        progress: called with stage, steps done and all steps.

    Raises:
        InputError: an unusable crop, or a structure that stays empty or too large.
        ValueError: not as many seeds or names as vehicles, or unequal numbers of views.
    """
    names = names or [f"crop {i + 1}" for i in range(len(vehicles))]
    if not len(vehicles) == len(seeds) == len(names):
        raise ValueError(
            f"generate: {len(vehicles)} vehicles, {len(seeds)} seeds, {len(names)} names"
        )
    limits = limits or GenerationLimits()
    watch = Stopwatch(model.device)
    with watch.stage("condition"):
        condition = model.condition(vehicles, names, mode)
    with watch.stage("structure"):
        drawn = draw_structures(
            seeds, names, model.structure_shape,
            lambda noise, which: model.sample_structure(
                noise, Condition(condition.views[:, which], mode), structure, progress
            ),
            model.active_voxels, limits, limits.max_voxels or model.trained_voxels,
        )  # fmt: skip
    with watch.stage("latent"):
        noise = [
            torch.randn(len(one.coords), model.latent_channels, generator=one.draw.generator)
            for one in drawn
        ]
        latents = model.sample_latent(
            [one.coords for one in drawn], noise, condition, latent, progress
        )
    with watch.stage("decode"):
        gaussians = model.decode(latents)
    made = tuple(
        GeneratedVehicle(
            asset.to("cpu"),
            one.draw.seed,
            one.latent.cpu(),
            one.coords.cpu(),
            latents.feats[rows].cpu(),
        )
        for asset, one, rows in zip(gaussians, drawn, latents.slices, strict=True)
    )
    return Generation(made, watch.seconds, watch.peak_bytes())
