"""The recipe of the small model's autoencoders and image encoder, and what they reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.core.files import write_json
from recast.reconstruction.scores import psnr
from recast.training.loop import TrainingTask, Watch, train
from recast.training.state import TrainerSettings
from recast.trellis import crop_to_object
from recast.trellis.checkpoint_sizes import SMALL, new_checkpoint
from recast.trellis.conditioning import CompactImageEncoder
from recast.trellis.flow_transformer import SparseStructureFlowModel
from recast.trellis.model_files import (
    GAUSSIAN_DECODER,
    IMAGE_ENCODER,
    LATENT_ENCODER,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
    save_model,
)
from recast.trellis.vae import (
    SLatEncoder,
    SLatGaussianDecoder,
    SparseStructureDecoder,
    SparseStructureEncoder,
)
from recast_tools.small_model.asset_store import AssetStore, occupancy, voxel_features
from recast_tools.small_model.autoencoders import (
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
    part = _Part(assets, out, seed, watch, (STRUCTURE_ENCODER, STRUCTURE_DECODER))
    encoder, decoder = part.models
    with torch.no_grad():
        decoder.out_layer[-1].bias.fill_(_PRIOR_LOGIT)
    resolution = SMALL.models[LATENT_ENCODER].args["resolution"]
    return part.train(
        StructureAutoencoderTask(encoder, decoder, part.store, part.trained, resolution, batch=4),
        lambda: evaluate_structure(encoder, decoder, part.store, part.held_out, resolution),
        {"steps": steps, "lr": 4e-3, "warmup": 50, "clip": 1.0},
    )


def train_latent(assets: Path, out: Path, steps: int, seed: int, watch: Watch) -> Report:
    """The structured-latent autoencoder; writes both networks and held-out PSNR and overlap."""
    part = _Part(assets, out, seed, watch, (LATENT_ENCODER, GAUSSIAN_DECODER))
    encoder, decoder = part.models
    return part.train(
        LatentAutoencoderTask(encoder, decoder, part.store, part.trained),
        lambda: evaluate_latent(encoder, decoder, part.store, part.held_out),
        {"steps": steps, "lr": 2e-3, "warmup": 100, "clip": 0.5},
    )


def train_image(
    assets: Path, structure: SparseStructureEncoder, out: Path, steps: int, seed: int, watch: Watch
) -> Report:
    """The image encoder, with the structure flow's network as its reader; see `ImageEncoderTask`.

    Args:
        structure: trained encoder that gives the latents to read.
    """
    part = _Part(assets, out, seed, watch, (STRUCTURE_FLOW, IMAGE_ENCODER))
    reader, encoder = part.models
    examples = image_examples(part.store, structure)
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        heads = ViewHeads(encoder.config.channels)
    trained, deviation = part.trained, float(examples.structures[part.trained].std())
    batch = min(16, len(trained))
    return part.train(
        ImageEncoderTask(encoder, reader, heads, examples, trained, batch, deviation),
        lambda: evaluate_image(encoder, reader, examples, trained, part.held_out, deviation),
        {"steps": steps, "lr": 1e-3, "warmup": 200, "clip": 1.0, "ema_decay": 0.998},
    )


class _Part:
    """Assets, and the fresh networks of some roles, in the order of the roles."""

    def __init__(
        self, assets: Path, out: Path, seed: int, watch: Watch, roles: tuple[str, ...]
    ) -> None:
        self.store, self._out, self._seed, self._watch = AssetStore(assets), out, seed, watch
        self.trained, self.held_out = split(len(self.store))
        self._roles = roles
        made = new_checkpoint(SMALL, seed, roles=roles).models
        self.models: list[Any] = [made[role] for role in roles]

    def train(
        self, task: TrainingTask, evaluate: Callable[[], Report], settings: dict[str, Any]
    ) -> Report:
        """Train; then write the networks and what they reach."""
        chosen = {"schedule": "cosine", "betas": (0.9, 0.99), "seed": self._seed, **settings}
        state = train(task, TrainerSettings.model_validate(chosen), self._out, watch=self._watch)
        for name, average in state.averages.items():
            average.copy_to(task.modules[name])
        for module in task.modules.values():
            module.eval()
        for role, model in zip(self._roles, self.models, strict=True):
            save_model(self._out / SMALL.models[role].stem, model)
        report = evaluate()
        write_json(self._out / REPORT_FILE, report)
        return report


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


@torch.no_grad()
def evaluate_structure(
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
def evaluate_latent(
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
def evaluate_image(
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
