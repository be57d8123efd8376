"""Whether the models of a folder fit together: classes, channels, resolutions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from recast.errors import InputError
from recast.trellis.checkpoints.record import PIPELINE_FILE, PipelineRecord
from recast.trellis.checkpoints.roles import (
    GAUSSIAN_DECODER,
    LATENT_ENCODER,
    LATENT_FLOW,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
)
from recast.trellis.conditioning import ImageEncoder
from recast.trellis.models.base import TrellisModel

ROLE_CLASSES: Mapping[str, str] = {
    STRUCTURE_FLOW: "SparseStructureFlowModel",
    STRUCTURE_DECODER: "SparseStructureDecoder",
    LATENT_FLOW: "SLatFlowModel",
    GAUSSIAN_DECODER: "SLatGaussianDecoder",
    STRUCTURE_ENCODER: "SparseStructureEncoder",
    LATENT_ENCODER: "SLatEncoder",
}


def check_agreement(
    folder: Path,
    record: PipelineRecord,
    models: Mapping[str, TrellisModel],
    encoder: ImageEncoder | None,
) -> None:
    """Check that models, which may be on the meta device, can work together.

    Raises:
        InputError: a model is not of its role's class, or channels or resolutions differ.
    """
    where = folder / PIPELINE_FILE
    for role, model in models.items():
        expected = ROLE_CLASSES.get(role, model.published_name)
        if model.published_name != expected:
            raise InputError(
                where, f"models.{role}", f"is a {model.published_name}, not a {expected}",
                "correct the path",
            )  # fmt: skip
    for what, members in _facts(record, models, encoder).items():
        if len(set(members.values())) > 1:
            listed = ", ".join(f"{value} of {name}" for name, value in members.items())
            raise InputError(where, what, f"differ ({listed})", "take all models from one training")


def _facts(
    record: PipelineRecord, models: Mapping[str, TrellisModel], encoder: ImageEncoder | None
) -> dict[str, dict[str, int]]:
    """Numbers that must be equal within each group, by who says so."""
    condition: dict[str, int] = {} if encoder is None else {"the image encoder": encoder.channels}
    structure: dict[str, int] = {}
    latent = {"slat_normalization": len(record.slat_statistics[0])}
    voxels: dict[str, int] = {}
    for role, model in models.items():
        config: Any = model.config
        if role in (STRUCTURE_FLOW, LATENT_FLOW):
            condition[role] = config.cond_channels
            group = structure if role == STRUCTURE_FLOW else latent
            group[f"{role} (in)"] = config.in_channels
            group[f"{role} (out)"] = config.out_channels
        if role in (STRUCTURE_DECODER, STRUCTURE_ENCODER):
            structure[role] = config.latent_channels
        if role in (GAUSSIAN_DECODER, LATENT_ENCODER):
            latent[role] = config.latent_channels
        if role in (LATENT_FLOW, GAUSSIAN_DECODER, LATENT_ENCODER):
            voxels[role] = config.resolution
    if STRUCTURE_FLOW in models:
        flow: Any = models[STRUCTURE_FLOW].config
        for role in (STRUCTURE_DECODER, STRUCTURE_ENCODER):
            if role in models:
                levels: Any = models[role].config
                voxels[role] = flow.resolution * 2 ** (len(levels.channels) - 1)
    return {
        "condition channels": condition,
        "channels of the structure": structure,
        "channels of the structured latent": latent,
        "voxels along an axis": voxels,
    }
