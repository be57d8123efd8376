"""The recipe of the small model's autoencoders and image encoder, one function a step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.recar.assets.store import AssetStore, occupancy
from recast.recar.autoencoders.image import (
    ImageEncoderTask,
    ImageExamples,
    ViewHeads,
    side_colours,
    view_azimuths,
)
from recast.recar.autoencoders.judge import judge_image, judge_latent, judge_structure
from recast.recar.autoencoders.latent import LatentAutoencoderTask
from recast.recar.autoencoders.split import split
from recast.recar.autoencoders.structure import StructureAutoencoderTask
from recast.recar.training.loop import Watch, train
from recast.recar.training.settings import TrainerSettings
from recast.recar.training.task import TrainingTask
from recast.storage import write_json
from recast.trellis import crop_to_object
from recast.trellis.checkpoints import SMALL, new_checkpoint, save_model
from recast.trellis.checkpoints.roles import (
    GAUSSIAN_DECODER,
    IMAGE_ENCODER,
    LATENT_ENCODER,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
)
from recast.trellis.models import SparseStructureEncoder
from recast.trellis.models.base import TrellisModel

REPORT_FILE = "report.json"
_PRIOR_LOGIT = -3.0  # of a voxel to be occupied: a twentieth of them are

Report = dict[str, Any]


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
        task, settings, out, watch, (STRUCTURE_ENCODER, STRUCTURE_DECODER),
        lambda: judge_structure(encoder, decoder, store, held_out, resolution),
    )  # fmt: skip


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
        task, settings, out, watch, (LATENT_ENCODER, GAUSSIAN_DECODER),
        lambda: judge_latent(encoder, decoder, store, held_out),
    )  # fmt: skip


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
        steps=steps, lr=1e-3, schedule="cosine", warmup=200, betas=(0.9, 0.99), clip=1.0, seed=seed,
        ema_decay=0.998,
    )  # fmt: skip
    return _finish(
        task, settings, out, watch, (IMAGE_ENCODER, STRUCTURE_FLOW),
        lambda: judge_image(encoder, reader, examples, trained, held_out, deviation),
    )  # fmt: skip


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
        np.array(crops), torch.stack(latents), torch.stack(azimuths), torch.stack(extents),
        torch.stack(sides),
    )  # fmt: skip


def _finish(
    task: TrainingTask, settings: TrainerSettings, out: Path, watch: Watch,
    roles: tuple[str, ...], judge: Callable[[], Report],
) -> Report:  # fmt: skip
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
