"""From crops of vehicles to 3D Gaussians, several in one batch, each with its own seed.

Condition, structure, structured latent, decoder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.splats import Gaussians, LowPass
from recast.trellis.checkpoints import Checkpoint, load_checkpoint
from recast.trellis.conditioning import crop_to_object, images_from_crops
from recast.trellis.generation import (
    TRAINED_VOXEL_SHARE,
    GeneratedVehicle,
    Generation,
    GenerationLimits,
    Stopwatch,
    draw_structures,
)
from recast.trellis.models.ss_vae import occupied_voxels
from recast.trellis.sampler import Condition, MultiImageMode, SamplerSettings, StepRecord, sample
from recast.trellis.sparse import SparseTensor

RgbaImage = NDArray[np.uint8]
Progress = Callable[[str, int, int], None]


class ImageTo3D:
    """The image-to-3D model of TRELLIS (Xiang et al. 2024) for one or several views of a vehicle.

    These are the stages; `recast.trellis.generate` runs them. Nothing here keeps gradients.

    Args:
        checkpoint: all models of the generation and the image encoder.
    """

    def __init__(self, checkpoint: Checkpoint) -> None:
        self.checkpoint = checkpoint
        self.structure_settings = checkpoint.record.sparse_structure_settings
        self.latent_settings = checkpoint.record.slat_settings
        models: Any = checkpoint.models
        self.structure_flow = models["sparse_structure_flow_model"]
        self.structure_decoder = models["sparse_structure_decoder"]
        self.latent_flow = models["slat_flow_model"]
        self.decoder = models["slat_decoder_gs"]
        self.encoder = checkpoint.encoder
        self.device = self.structure_flow.device
        mean, std = checkpoint.record.slat_statistics
        self.latent_mean = torch.tensor(mean, device=self.device)
        self.latent_std = torch.tensor(std, device=self.device)

    @classmethod
    def load(
        cls,
        folder: str | Path,
        *,
        device: str | None = None,
        torso_dtype: torch.dtype | None = None,
        image_encoder: str | Path | None = None,
    ) -> ImageTo3D:
        """Read a folder in the published layout, with pipeline.json and ckpts/.

        Args:
            device: device to run on; None takes CUDA where there is some.
            torso_dtype: dtype of the transformer blocks; None takes float16 on CUDA, else float32.
            image_encoder: weights of the published image encoder, where the folder has none.

        Raises:
            InputError: see `load_checkpoint`.
        """
        device = device or ("cuda" if torch.cuda.is_available() else "cpu")
        if torso_dtype is None:
            torso_dtype = torch.float16 if device.startswith("cuda") else torch.float32
        encoder = None if image_encoder is None else Path(image_encoder)
        return cls(
            load_checkpoint(
                Path(folder), device=device, torso_dtype=torso_dtype, image_encoder=encoder
            )
        )

    @property
    def structure_shape(self) -> tuple[int, int, int, int]:
        """(C, R, R, R) of a sparse-structure latent."""
        config = self.structure_flow.config
        return config.in_channels, config.resolution, config.resolution, config.resolution

    @property
    def latent_channels(self) -> int:
        """Of a structured latent."""
        return int(self.latent_flow.config.in_channels)

    @property
    def low_pass(self) -> LowPass:
        """The filter through which the decoder was trained to be looked at (Mip-Splatting's)."""
        return LowPass(self.decoder.config.representation_config.filter_2d, antialiased=True)

    @property
    def trained_voxels(self) -> int:
        """Most active voxels that the networks were trained on."""
        return int(TRAINED_VOXEL_SHARE * self.latent_flow.config.resolution**2)

    @torch.no_grad()
    def condition(
        self,
        vehicles: Sequence[Sequence[RgbaImage]],
        names: Sequence[str],
        mode: MultiImageMode = "stochastic",
    ) -> Condition:
        """Encode the views of vehicles: tokens (V, B, L, C)."""
        counts = {len(views) for views in vehicles}
        if len(counts) != 1 or 0 in counts:
            raise ValueError(
                f"condition: vehicles of a batch have different numbers of views: {sorted(counts)}"
            )
        crops = [
            crop_to_object(view, self.encoder.image_size, where=name)
            for name, views in zip(names, vehicles, strict=True)
            for view in views
        ]
        pixels = images_from_crops(crops).to(self.device)
        tokens = self.encoder.encode(pixels)
        by_view = tokens.unflatten(0, (len(vehicles), -1)).transpose(0, 1)
        return Condition(by_view.contiguous(), mode)

    @torch.no_grad()
    def sample_structure(
        self,
        noise: Tensor,
        condition: Condition,
        settings: SamplerSettings | None = None,
        progress: Progress | None = None,
    ) -> Tensor:
        """Sparse-structure latents (B, C, R, R, R) from noise of that shape.

        The settings are those of the checkpoint where none are given.
        """
        settings = settings or self.structure_settings
        return sample(
            self.structure_flow,
            noise.to(self.device),
            condition,
            settings,
            on_step=_reporter("structure", settings, progress),
        )

    @torch.no_grad()
    def active_voxels(self, structure: Tensor) -> Tensor:
        """Voxels (T, 3) int32, in lexicographic order, where a structure (C, R, R, R) is occupied.

        Occupied is a logit above zero.
        """
        logits = self.structure_decoder(structure[None])
        return occupied_voxels(logits)[:, 1:]

    @torch.no_grad()
    def sample_latent(
        self,
        coords: Sequence[Tensor],
        noise: Sequence[Tensor],
        condition: Condition,
        settings: SamplerSettings | None = None,
        progress: Progress | None = None,
    ) -> SparseTensor:
        """Structured latents, de-normalised, on voxels (T, 3) of each sample from noise (T, C).

        The settings are those of the checkpoint where none are given.
        """
        settings = settings or self.latent_settings
        start = SparseTensor.stack(
            [c.to(self.device) for c in coords], [n.to(self.device) for n in noise]
        )

        def velocity(feats: Tensor, t: Tensor, cond: Tensor) -> Tensor:
            out: SparseTensor = self.latent_flow(start.with_feats(feats), t, cond)
            return out.feats

        feats = sample(
            velocity,
            start.feats,
            condition,
            settings,
            samples=start.batch_size,
            on_step=_reporter("latent", settings, progress),
        )
        return start.with_feats(feats * self.latent_std + self.latent_mean)

    @torch.no_grad()
    def decode(self, latent: SparseTensor) -> list[Gaussians]:
        """Gaussians of each sample from de-normalised structured latents."""
        return self.decoder.gaussians(self.decoder(latent))


def _reporter(
    stage: str, settings: SamplerSettings, progress: Progress | None
) -> Callable[[StepRecord], None] | None:
    if progress is None:
        return None
    return lambda record: progress(stage, record.step + 1, settings.steps)


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
        vehicles: views of each vehicle, (H, W, 4) uint8 RGBA with straight alpha; the same number
            of views for all. The order of the views matters, see `Condition`.
        seeds: one for each vehicle.
        names: what messages call them; "crop 1", ... where not given.
        mode: how several views are used, see `Condition`.
        structure, latent: samplers; those of the checkpoint where not given.
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
            seeds,
            names,
            model.structure_shape,
            lambda noise, which: model.sample_structure(
                noise, Condition(condition.views[:, which], mode), structure, progress
            ),
            model.active_voxels,
            limits,
            limits.max_voxels or model.trained_voxels,
        )
    with watch.stage("latent"):
        noise = [
            torch.randn(len(one.coords), model.latent_channels, generator=one.generator)
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
            one.seed,
            one.latent.cpu(),
            one.coords.cpu(),
            latents.feats[rows].cpu(),
        )
        for asset, one, rows in zip(gaussians, drawn, latents.slices, strict=True)
    )
    return Generation(made, watch.seconds, watch.peak_bytes())
