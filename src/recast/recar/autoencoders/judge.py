"""What the autoencoders and the image encoder reach on assets they have not seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.recar.assets.store import AssetStore, occupancy, voxel_features
from recast.recar.autoencoders.image import ImageExamples, read_structure
from recast.recar.autoencoders.latent import draw, picture
from recast.recar.autoencoders.structure import voxel_overlap
from recast.scene import psnr
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.models import (
    SLatEncoder,
    SLatGaussianDecoder,
    SparseStructureDecoder,
    SparseStructureEncoder,
)
from recast.trellis.models.ss_flow import SparseStructureFlowModel

_EVERY_VIEW = 4  # of an asset's pictures, every fourth is enough


@torch.no_grad()
def judge_structure(
    encoder: SparseStructureEncoder, decoder: SparseStructureDecoder, store: AssetStore,
    numbers: Sequence[int], resolution: int,
) -> dict[str, Any]:  # fmt: skip
    """Overlap of decoded and true voxels, vehicles and shapes apart."""
    found: dict[str, list[float]] = {"vehicles": [], "shapes": []}
    for number in numbers:
        asset = store[number]
        grid = occupancy([asset], resolution)
        overlap = voxel_overlap(decoder(encoder(grid).mean) > 0, grid > 0)
        found["shapes" if asset.kind.startswith("shape") else "vehicles"].append(float(overlap))
    return {f"{name}_iou": _mean(values) for name, values in found.items()}


@torch.no_grad()
def judge_latent(
    encoder: SLatEncoder, decoder: SLatGaussianDecoder, store: AssetStore, numbers: Sequence[int]
) -> dict[str, Any]:
    """PSNR on black, PSNR on the asset's pixels, and mask overlap of decoded vehicles."""
    scores: dict[str, list[float]] = {"psnr": [], "psnr_object": [], "mask_iou": []}
    black = torch.zeros(3)
    for number in numbers:
        asset = store[number]
        if asset.kind.startswith("shape"):
            continue
        (gaussians,) = decoder.gaussians(decoder(encoder(voxel_features([asset])).mean))
        for view in range(0, len(asset.pictures), _EVERY_VIEW):
            drawn = draw(gaussians, asset, view, black)
            truth, alpha = picture(asset, view, black)
            rgb, inside = drawn.rgb.clamp(0, 1), alpha > 0.5
            scores["psnr"].append(psnr(rgb, truth))
            scores["psnr_object"].append(psnr(rgb[inside], truth[inside]))
            overlap = voxel_overlap((drawn.alpha > 0.5)[None], inside[None])
            scores["mask_iou"].append(float(overlap))
    return {name: _mean(values) for name, values in scores.items()}


@torch.no_grad()
def judge_image(
    encoder: CompactImageEncoder, reader: SparseStructureFlowModel, examples: ImageExamples,
    trained: Sequence[int], held_out: Sequence[int], deviation: float,
) -> dict[str, Any]:  # fmt: skip
    """Error of the structure read from unseen pictures, beside two that do not read.

    `error` is the mean squared error over the variance; `shuffled` that with another asset's
    picture, `nearest_picture` that of the structure of the training picture with the least squared
    difference of pixels, `mean` that of the mean structure.
    """
    views = examples.crops.shape[1]
    known = torch.from_numpy(examples.crops[trained].reshape(len(trained) * views, -1)[:, ::7])
    known = known.float()
    rows: dict[str, list[float]] = {
        "error": [], "shuffled": [], "nearest_picture": [], "mean": []
    }  # fmt: skip
    mean = examples.structures[trained].mean(dim=0)

    def error(found: Tensor, number: int) -> float:
        return float((found - examples.structures[number]).square().mean()) / deviation**2

    for place, number in enumerate(held_out):
        pixels = torch.from_numpy(examples.crops[number]).permute(0, 3, 1, 2) / 255
        read = read_structure(reader, encoder.encode(pixels))
        other = held_out[(place + 1) % len(held_out)]
        for view in range(views):
            rows["error"].append(error(read[view], number))
            rows["shuffled"].append(error(read[view], other))
            seen = torch.from_numpy(examples.crops[number, view].reshape(-1)[::7]).float()
            nearest = int((known - seen).square().sum(dim=1).argmin()) // views
            rows["nearest_picture"].append(error(examples.structures[trained[nearest]], number))
            rows["mean"].append(error(mean, number))
    return {name: _mean(values) for name, values in rows.items()}


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
