"""Two sets of networks, the published ones and small ones for a CPU; and untrained checkpoints."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from recast.trellis.checkpoints import Checkpoint
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.layers import TrellisModel
from recast.trellis.model_files import (
    GAUSSIAN_DECODER,
    IMAGE_ENCODER,
    LATENT_ENCODER,
    LATENT_FLOW,
    PUBLISHED_BACKBONE,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
    PipelineRecord,
    build,
)
from recast.trellis.sampler import SamplerSettings


@dataclass(frozen=True)
class ModelSize:
    """Path in the folder (without ending), published class name and arguments of one model."""

    stem: str
    name: str
    args: Mapping[str, Any]


@dataclass(frozen=True)
class CheckpointSizes:
    """All models of a checkpoint."""

    # sizes by role; the image encoder among them, where it is not the published backbone.
    models: Mapping[str, ModelSize]
    backbone: ModelSize | None  # the published image encoder, kept apart from the folder
    # mean, std: mean and standard deviation of the structured latent, one value a channel.
    mean: tuple[float, ...]
    std: tuple[float, ...]

    @property
    def record(self) -> PipelineRecord:
        """`pipeline.json` with the published sampler settings."""
        return PipelineRecord.of(
            {role: size.stem for role, size in self.models.items()},
            SamplerSettings(),
            SamplerSettings(),
            self.mean,
            self.std,
            PUBLISHED_BACKBONE if self.backbone else IMAGE_ENCODER,
        )


_LATENT_CHANNELS = 8


def _flow(channels: int, blocks: int, heads: int, condition: int, fp16: bool) -> dict[str, Any]:
    return {
        "in_channels": _LATENT_CHANNELS,
        "out_channels": _LATENT_CHANNELS,
        "model_channels": channels,
        "cond_channels": condition,
        "num_blocks": blocks,
        "num_heads": heads,
        "mlp_ratio": 4,
        "pe_mode": "ape",
        "qk_rms_norm": True,
        "use_fp16": fp16,
    }


def _grid(channels: list[int], res_blocks: int, fp16: bool) -> dict[str, Any]:
    return {
        "latent_channels": _LATENT_CHANNELS,
        "num_res_blocks": res_blocks,
        "num_res_blocks_middle": res_blocks,
        "channels": channels,
        "use_fp16": fp16,
    }


def _voxels(resolution: int, channels: int, blocks: int, heads: int, fp16: bool) -> dict[str, Any]:
    return {
        "resolution": resolution,
        "model_channels": channels,
        "latent_channels": _LATENT_CHANNELS,
        "num_blocks": blocks,
        "num_heads": heads,
        "mlp_ratio": 4,
        "attn_mode": "swin",
        "window_size": 8,
        "use_fp16": fp16,
    }


def _representation(num_gaussians: int, scaling_bias: float) -> dict[str, Any]:
    rates = {"_xyz": 1.0, "_features_dc": 1.0, "_opacity": 1.0, "_scaling": 1.0, "_rotation": 0.1}
    return {
        "lr": rates,
        "perturb_offset": True,
        "voxel_size": 1.5,
        "num_gaussians": num_gaussians,
        "2d_filter_kernel_size": 0.1,
        "3d_filter_kernel_size": 9e-4,
        "scaling_bias": scaling_bias,
        "opacity_bias": 0.1,
        "scaling_activation": "softplus",
    }


_SMALL_VOXELS = {**_voxels(32, 64, 3, 4, False), "mlp_ratio": 2, "window_size": 4}

OFFICIAL = CheckpointSizes(
    {
        STRUCTURE_FLOW: ModelSize(
            "ckpts/ss_flow_img_dit_L_16l8_fp16",
            "SparseStructureFlowModel",
            {"resolution": 16, "patch_size": 1, **_flow(1024, 24, 16, 1024, True)},
        ),
        STRUCTURE_DECODER: ModelSize(
            "ckpts/ss_dec_conv3d_16l8_fp16",
            "SparseStructureDecoder",
            {"out_channels": 1, **_grid([512, 128, 32], 2, True)},
        ),
        LATENT_FLOW: ModelSize(
            "ckpts/slat_flow_img_dit_L_64l8p2_fp16",
            "SLatFlowModel",
            {
                "resolution": 64,
                "patch_size": 2,
                "num_io_res_blocks": 2,
                "io_block_channels": [128],
                **_flow(1024, 24, 16, 1024, True),
            },
        ),
        GAUSSIAN_DECODER: ModelSize(
            "ckpts/slat_dec_gs_swin8_B_64l8gs32_fp16",
            "SLatGaussianDecoder",
            {**_voxels(64, 768, 12, 12, True), "representation_config": _representation(32, 4e-3)},
        ),
        STRUCTURE_ENCODER: ModelSize(
            "ckpts/ss_enc_conv3d_16l8_fp16",
            "SparseStructureEncoder",
            {"in_channels": 1, **_grid([32, 128, 512], 2, True)},
        ),
        LATENT_ENCODER: ModelSize(
            "ckpts/slat_enc_swin8_B_64l8_fp16",
            "SLatEncoder",
            {"in_channels": 1024, **_voxels(64, 768, 12, 12, True)},
        ),
    },
    ModelSize("dinov2", "DinoVisionTransformer", {}),
    (
        -2.1687545776367188,
        -0.004347046371549368,
        -0.13352349400520325,
        -0.08418072760105133,
        -0.5271206498146057,
        0.7238689064979553,
        -1.1414450407028198,
        1.2039363384246826,
    ),
    (
        2.377650737762451,
        2.386378288269043,
        2.124418020248413,
        2.1748552322387695,
        2.663944721221924,
        2.371192216873169,
        2.6217446327209473,
        2.684523105621338,
    ),
)
"""The published image-to-3D checkpoints of TRELLIS (Xiang et al. 2024): 64^3 voxels."""

SMALL = CheckpointSizes(
    {
        STRUCTURE_FLOW: ModelSize(
            "ckpts/ss_flow",
            "SparseStructureFlowModel",
            {"resolution": 8, "patch_size": 2, "pool_cond": True, **_flow(192, 6, 6, 128, False)},
        ),
        STRUCTURE_DECODER: ModelSize(
            "ckpts/ss_dec",
            "SparseStructureDecoder",
            {"out_channels": 1, **_grid([64, 24, 4], 1, False)},
        ),
        LATENT_FLOW: ModelSize(
            "ckpts/slat_flow",
            "SLatFlowModel",
            {
                "resolution": 32,
                "patch_size": 2,
                "num_io_res_blocks": 2,
                "pool_cond": True,
                "io_block_channels": [16],
                **_flow(128, 3, 4, 128, False),
            },
        ),
        GAUSSIAN_DECODER: ModelSize(
            "ckpts/slat_dec_gs",
            "SLatGaussianDecoder",
            {
                **_SMALL_VOXELS,
                "num_blocks": 3,
                "representation_config": {
                    **_representation(8, 8e-3),
                    "opacity_bias": 0.3,
                    "base_color": True,
                },
            },
        ),
        STRUCTURE_ENCODER: ModelSize(
            "ckpts/ss_enc",
            "SparseStructureEncoder",
            {"in_channels": 1, **_grid([4, 24, 64], 1, False)},
        ),
        # Of a voxel: colour, normal, centroid and which of its 2x2x2 parts are occupied.
        LATENT_ENCODER: ModelSize(
            "ckpts/slat_enc",
            "SLatEncoder",
            {"in_channels": 17, **_SMALL_VOXELS, "num_blocks": 2, "skip_latent": True},
        ),
        IMAGE_ENCODER: ModelSize(
            "ckpts/image_encoder",
            "CompactImageEncoder",
            {
                "image_size": 128,
                "stem_channels": [32, 64, 96],
                "channels": 128,
                "num_blocks": 4,
                "num_heads": 4,
            },
        ),
    },
    None,
    (0.0,) * _LATENT_CHANNELS,
    (1.0,) * _LATENT_CHANNELS,
)
"""32^3 voxels, 64 structure tokens, 8 Gaussians a voxel: minutes of training, seconds to sample."""


def new_checkpoint(
    sizes: CheckpointSizes,
    seed: int,
    *,
    roles: Sequence[str] | None = None,
    with_encoder: bool = True,
) -> Checkpoint:
    """Networks with initial weights, on the CPU, in evaluation mode.

    A model's weights depend on the seed and its role only, not on which others are made. Output
    layers of the flows and of the Gaussian decoder start at zero, as the published training does.

    Args:
        sizes: `OFFICIAL`, `SMALL` or others.
        roles: roles of the models to make; all where not given.
        with_encoder: whether to make the image encoder; 1.2 GB for the published one.

    Returns:
        As `load_checkpoint` gives; the models are what `save_checkpoint` writes.
    """
    models = {
        role: _seeded(size, role, seed)
        for role, size in sizes.models.items()
        if roles is None or role in roles or (with_encoder and role == sizes.record.encoder_role)
    }
    encoder: TrellisModel | None = None
    if with_encoder and sizes.backbone is not None:
        encoder = _seeded(sizes.backbone, "image encoder", seed)
    elif with_encoder:
        encoder = models.get(sizes.record.encoder_role or "")
    known = encoder if isinstance(encoder, ImageEncoder) else None
    return Checkpoint(None, sizes.record, models, known)


def _seeded(size: ModelSize, role: str, seed: int) -> TrellisModel:
    # On the CPU torch takes no more than 32 bits of a seed.
    mixed = hashlib.blake2b(f"{role} {seed}".encode(), digest_size=4).digest()
    # Constructors draw from torch's own generator, which is put back as it was.
    with torch.random.fork_rng(devices=()):
        torch.random.default_generator.manual_seed(int.from_bytes(mixed, "little"))
        return build(size.name, size.args, f"size of {role}").eval()
