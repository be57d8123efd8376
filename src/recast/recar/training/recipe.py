"""The recipe of the small model's autoencoders and image encoder, and what they reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.core.files import write_json
from recast.recar.training.assets import AssetStore, occupancy, voxel_features
from recast.recar.training.autoencoders import (
    ImageEncoderTask,
    ImageExamples,
    LatentAutoencoderTask,
    StructureAutoencoderTask,
    ViewHeads,
    draw,
    picture,
    read_structure,
    side_colours,
    view_azimuths,
    voxel_overlap,
)
from recast.recar.training.loop import Watch, train
from recast.recar.training.task import TrainerSettings, TrainingTask
from recast.scene import psnr
from recast.trellis import crop_to_object
from recast.trellis.checkpoints import SMALL, new_checkpoint, save_model
from recast.trellis.checkpoints.record import (
    GAUSSIAN_DECODER,
    IMAGE_ENCODER,
    LATENT_ENCODER,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
)
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.models import (
    SLatEncoder,
    SLatGaussianDecoder,
    SparseStructureDecoder,
    SparseStructureEncoder,
)
from recast.trellis.models.base import TrellisModel
from recast.trellis.models.flow_transformer import SparseStructureFlowModel

_EVERY_VIEW = 4  # of an asset's pictures, every fourth is enough
HELD_OUT_EVERY = 20
REPORT_FILE = "report.json"
_PRIOR_LOGIT = -3.0  # of a voxel to be occupied: a twentieth of them are

Report = dict[str, Any]


def is_held_out(number: int) -> bool:
    """Whether an asset, by its number, is never trained on: one in twenty."""
    return number % HELD_OUT_EVERY == 0


def split(count: int) -> tuple[list[int], list[int]]:
    """Numbers of the assets to train on, and of those held out."""
    numbers = range(count)
    return (
        [number for number in numbers if not is_held_out(number)],
        [number for number in numbers if is_held_out(number)],
    )


def train_structure(assets: Path, out: Path, steps: int, seed: int, watch: Watch) -> Report:
    """The sparse-structure autoencoder; writes both networks and the held-out overlap."""
    store = AssetStore(assets)
    trained, held_out = split(len(store))
    made: dict[str, Any] = new_checkpoint(
        SMALL, seed, roles=(STRUCTURE_ENCODER, STRUCTURE_DECODER)
    ).models
    encoder, decoder = made[STRUCTURE_ENCODER], made[STRUCTURE_DECODER]
    with torch.no_grad():
        decoder.out_layer[-1].bias.fill_(_PRIOR_LOGIT)
    resolution = SMALL.models[LATENT_ENCODER].args["resolution"]
    task = StructureAutoencoderTask(encoder, decoder, store, trained, resolution, batch=4)
    settings = TrainerSettings(
        steps=steps, lr=4e-3, schedule="cosine", warmup=50, betas=(0.9, 0.99), clip=1.0, seed=seed
    )
    return _finish(
        task,
        settings,
        out,
        watch,
        (STRUCTURE_ENCODER, STRUCTURE_DECODER),
        lambda: judge_structure(encoder, decoder, store, held_out, resolution),
    )


def train_latent(assets: Path, out: Path, steps: int, seed: int, watch: Watch) -> Report:
    """The structured-latent autoencoder; writes both networks and held-out PSNR and overlap."""
    store = AssetStore(assets)
    trained, held_out = split(len(store))
    made: dict[str, Any] = new_checkpoint(
        SMALL, seed, roles=(LATENT_ENCODER, GAUSSIAN_DECODER)
    ).models
    encoder, decoder = made[LATENT_ENCODER], made[GAUSSIAN_DECODER]
    task = LatentAutoencoderTask(encoder, decoder, store, trained)
    settings = TrainerSettings(
        steps=steps, lr=2e-3, schedule="cosine", warmup=100, betas=(0.9, 0.99), clip=0.5, seed=seed
    )
    return _finish(
        task,
        settings,
        out,
        watch,
        (LATENT_ENCODER, GAUSSIAN_DECODER),
        lambda: judge_latent(encoder, decoder, store, held_out),
    )


def train_image(
    assets: Path, structure: SparseStructureEncoder, out: Path, steps: int, seed: int, watch: Watch
) -> Report:
    """The image encoder, with the structure flow's network as its reader; see `ImageEncoderTask`.

    Args:
        structure: trained encoder that gives the latents to read.
    """
    store = AssetStore(assets)
    trained, held_out = split(len(store))
    examples = image_examples(store, structure)
    made: dict[str, Any] = new_checkpoint(SMALL, seed, roles=(STRUCTURE_FLOW, IMAGE_ENCODER)).models
    encoder, reader = made[IMAGE_ENCODER], made[STRUCTURE_FLOW]
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        heads = ViewHeads(encoder.config.channels)
    deviation = float(examples.structures[trained].std())
    task = ImageEncoderTask(
        encoder, reader, heads, examples, trained, min(16, len(trained)), deviation
    )
    settings = TrainerSettings(
        steps=steps,
        lr=1e-3,
        schedule="cosine",
        warmup=200,
        betas=(0.9, 0.99),
        clip=1.0,
        seed=seed,
        ema_decay=0.998,
    )
    return _finish(
        task,
        settings,
        out,
        watch,
        (IMAGE_ENCODER, STRUCTURE_FLOW),
        lambda: judge_image(encoder, reader, examples, trained, held_out, deviation),
    )


@torch.no_grad()
def image_examples(store: AssetStore, structure: SparseStructureEncoder) -> ImageExamples:
    """All conditioning pictures of a store, cropped, with what is to be read from them."""
    size = SMALL.models[IMAGE_ENCODER].args["image_size"]
    resolution = SMALL.models[LATENT_ENCODER].args["resolution"]
    crops, latents, azimuths, extents, sides = [], [], [], [], []
    for number in range(len(store)):
        asset = store[number]
        crops.append([crop_to_object(one, size) for one in asset.pictures[: asset.crops]])
        latents.append(structure(occupancy([asset], resolution)).mean[0])
        azimuths.append(view_azimuths(asset))
        extents.append(torch.from_numpy(asset.size))
        sides.append(side_colours(asset))
    return ImageExamples(
        np.array(crops),
        torch.stack(latents),
        torch.stack(azimuths),
        torch.stack(extents),
        torch.stack(sides),
    )


def _finish(
    task: TrainingTask,
    settings: TrainerSettings,
    out: Path,
    watch: Watch,
    roles: tuple[str, ...],
    judge: Callable[[], Report],
) -> Report:
    state = train(task, settings, out, watch=watch)
    for name, average in state.averages.items():
        average.copy_to(task.modules[name])
    for module in task.modules.values():
        module.eval()
    for role in roles:
        model = task.modules[role]
        assert isinstance(model, TrellisModel)
        save_model(out / SMALL.models[role].stem, model)
    report = judge()
    write_json(out / REPORT_FILE, report)
    return report


@torch.no_grad()
def judge_structure(
    encoder: SparseStructureEncoder,
    decoder: SparseStructureDecoder,
    store: AssetStore,
    numbers: Sequence[int],
    resolution: int,
) -> dict[str, Any]:
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
    encoder: CompactImageEncoder,
    reader: SparseStructureFlowModel,
    examples: ImageExamples,
    trained: Sequence[int],
    held_out: Sequence[int],
    deviation: float,
) -> dict[str, Any]:
    """Error of the structure read from unseen pictures, beside two that do not read.

    `error` is the mean squared error over the variance; `shuffled` that with another asset's
    picture, `nearest_picture` that of the structure of the training picture with the least squared
    difference of pixels, `mean` that of the mean structure.
    """
    views = examples.crops.shape[1]
    known = torch.from_numpy(examples.crops[trained].reshape(len(trained) * views, -1)[:, ::7])
    known = known.float()
    rows: dict[str, list[float]] = {"error": [], "shuffled": [], "nearest_picture": [], "mean": []}
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
