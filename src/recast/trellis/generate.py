"""What a generation is asked for, and what comes out: limits, draws, vehicles, and a model."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.core.errors import InputError
from recast.splats import Gaussians, LowPass
from recast.trellis.checkpoints import Checkpoint, load_checkpoint
from recast.trellis.conditioning import crop_to_object, images_from_crops
from recast.trellis.sampler import Condition, MultiImageMode, SamplerSettings, StepRecord, sample
from recast.trellis.sparse import SparseTensor
from recast.trellis.vae import occupied_voxels
from recast.weights import shipped_folder

TRAINED_VOXEL_SHARE = 8
"""The published networks were trained on structures of at most 8 R^2 = 32,768 voxels at R = 64."""
RECAST_MINI = "recast-mini"
"""Its name, as a generator and of its folder."""
_VIEWER_FROM_NATIVE = torch.tensor(
    [[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
)


@dataclass(frozen=True)
class GenerationLimits:
    """What counts as a failed structure, and how often another seed is tried.

    Attributes:
        max_voxels: a structure with more active voxels is refused; None takes 8 R^2, the most that
            the published networks saw in training. Few sampling steps make structures explode.
        retries: further seeds (seed + 1, seed + 2, ...) tried for a vehicle whose structure is
            empty or too large.

    Raises:
        InputError: fewer than one voxel, or fewer than no retries.
    """

    max_voxels: int | None = None
    retries: int = 0

    def __post_init__(self) -> None:
        if self.max_voxels is not None and self.max_voxels < 1:
            raise InputError("`max_voxels`", "value", f"is {self.max_voxels}", "give 1 or more")
        if self.retries < 0:
            raise InputError("`retries`", "value", f"is {self.retries}", "give 0 or more")


@dataclass(frozen=True)
class GeneratedVehicle:
    """One vehicle in the frame of the networks: unit cube [-0.5, 0.5]^3, z up, any heading.

    Attributes:
        gaussians: the decoded asset, degree-zero harmonics.
        seed: the one that made it, which differs from the one asked for after a retry.
        structure: (C, R/8.., R/8.., R/8..) sparse-structure latent as sampled.
        coords: (T, 3) int32 active voxels.
        latent: (T, C) structured latent on them, de-normalised.
    """

    gaussians: Gaussians
    seed: int
    structure: Tensor
    coords: Tensor
    latent: Tensor


@dataclass(frozen=True)
class Generation:
    """The vehicles of one call, and what it cost.

    Attributes:
        vehicles: vehicles in the order of the request.
        seconds: wall time by stage: condition, structure, latent, decode.
        peak_bytes: most memory in use: of the accelerator, or resident memory of this process.
    """

    vehicles: tuple[GeneratedVehicle, ...]
    seconds: Mapping[str, float]
    peak_bytes: int


@dataclass(frozen=True)
class Structure:
    """A structure that passed the limits."""

    # random stream that it came from, on the CPU so that every device makes the same vehicle; it
    # continues with the latent's noise.
    generator: torch.Generator
    latent: Tensor  # (C, R, R, R) latent as sampled
    coords: Tensor  # (T, 3) int32 active voxels

    @property
    def seed(self) -> int:
        """Seed of the stream."""
        return self.generator.initial_seed()


def draw_structures(
    seeds: Sequence[int],
    names: Sequence[str],
    shape: Sequence[int],
    sample: Callable[[Tensor, list[int]], Tensor],
    decode: Callable[[Tensor], Tensor],
    limits: GenerationLimits,
    max_voxels: int,
) -> list[Structure]:
    """Sample a structure for each seed; one that is empty or too large is drawn anew or refused.

    Args:
        shape: shape of one noise, (C, R, R, R).
        sample: function from noises (B, C, R, R, R) and the indices of their vehicles to latents of
            that shape.
        decode: function from one latent to its active voxels (T, 3).
        limits: limits, of which the number of retries is used.
        max_voxels: largest number of active voxels allowed.

    Raises:
        InputError: a vehicle failed with every seed allowed.
    """
    done: dict[int, Structure] = {}
    for attempt in range(limits.retries + 1):
        waiting = [i for i in range(len(seeds)) if i not in done]
        if not waiting:
            break
        streams = [torch.Generator().manual_seed(seeds[i] + attempt) for i in waiting]
        noise = torch.stack([torch.randn(*shape, generator=stream) for stream in streams])
        latents = sample(noise, waiting)
        for i, stream, latent in zip(waiting, streams, latents, strict=True):
            coords = decode(latent)
            if 0 < len(coords) <= max_voxels:
                done[i] = Structure(stream, latent, coords)
            elif attempt == limits.retries:
                raise _failure(names[i], seeds[i], limits.retries, len(coords), max_voxels)
    return [done[i] for i in range(len(seeds))]


def _failure(name: str, seed: int, retries: int, voxels: int, max_voxels: int) -> InputError:
    tried = f"seed {seed}" if retries == 0 else f"seeds {seed} to {seed + retries}"
    if voxels == 0:
        problem = "the sampled structure is empty"
    else:
        problem = f"the sampled structure has {voxels} voxels, at most {max_voxels} are allowed"
    return InputError(name, tried, problem, "try another seed, more retries or more sampling steps")


class Stopwatch:
    """Measures the stages of one call; work on CUDA is waited for at the end of each stage."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.seconds: dict[str, float] = {}
        if device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(device)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to stage `name`."""
        start = time.perf_counter()
        yield
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def peak_bytes(self) -> int:
        """CUDA: most allocated since the start; else the peak resident memory of the process."""
        if self.device.type == "cuda":
            return int(torch.cuda.max_memory_allocated(self.device))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return int(peak if sys.platform == "darwin" else peak * 1024)  # Linux counts kilobytes


def recast_mini() -> Path:
    """Its folder in the published layout, with a model card (README.md)."""
    return shipped_folder(RECAST_MINI)


def viewer_frame(gaussians: Gaussians) -> Gaussians:
    """Turn native Gaussians (z up) into the frame of the usual splat viewers (-y up).

    (x, y, z) becomes (x, -z, y), the default of the published exporter. recast itself works in the
    native frame; its inverse is (x, y, z) = (x', z', -y').
    """
    return gaussians.transformed(_VIEWER_FROM_NATIVE)


# From crops of vehicles to 3D Gaussians, several in one batch, each with its own seed.
#
# Condition, structure, structured latent, decoder.

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
        """Channels of a structured latent."""
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
