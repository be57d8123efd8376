"""The parts of the small model: one is trained, then all become a model folder and a cache."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from rich.console import Console

from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar.target_cache import CACHE_FILE, CacheRecord, Target, TargetCache, TargetRecord
from recast.recar.target_maker import ModelSource
from recast.recar.training_conditions import TrainingAsset
from recast.trellis import SamplerSettings
from recast.trellis.checkpoint_sizes import SMALL, new_checkpoint
from recast.trellis.checkpoints import PipelineRecord, load_model, save_checkpoint
from recast.trellis.model_files import (
    GAUSSIAN_DECODER,
    IMAGE_ENCODER,
    LATENT_ENCODER,
    LATENT_FLOW,
    STRUCTURE_DECODER,
    STRUCTURE_ENCODER,
    STRUCTURE_FLOW,
    model_files,
)
from recast.trellis.vae import SparseStructureEncoder
from recast_tools.small_model.asset_store import (
    AssetStore,
    ChannelMoments,
    occupancy,
    voxel_features,
)
from recast_tools.small_model.recipe import (
    REPORT_FILE,
    Report,
    is_held_out,
    train_image,
    train_latent,
    train_structure,
)

SAMPLER = SamplerSettings(steps=12, cfg_strength=3.0)
"""Chosen on twelve held-out assets: as good as 25 steps at strength 5, in half the time."""

_PARTS = {
    "structure": (STRUCTURE_ENCODER, STRUCTURE_DECODER),
    "latent": (LATENT_ENCODER, GAUSSIAN_DECODER),
    "image": (IMAGE_ENCODER, STRUCTURE_FLOW),
}
Part = Literal["structure", "latent", "image"]
STEPS: dict[Part, int] = {"structure": 1500, "latent": 8000, "image": 3000}
"""Training steps of the shipped model."""


def assemble(
    assets: Path,
    parts: dict[str, Path],
    model: Path,
    cache: Path,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> None:
    """Write a model folder of trained parts, and encode the assets into a target cache.

    The structure flow begins as the image encoder's reader, the latent flow anew. The cache has
    the layout of pseudo-targets, so that the same training serves: structures and latents are the
    means of the encoders, voxels those of the assets.

    Args:
        assets: folder of training assets.
        parts: folders of the trainings "structure", "latent" and "image".
        model: model folder to be made.
        cache: target cache to be made; one that was begun is finished.
        seed: seed of the latent flow's weights.
        progress: called with the number of assets encoded, and of all.

    Raises:
        InputError: a part was not trained to its end, `model` exists, or the disk is full.
    """
    store = AssetStore(assets)
    models: dict[str, Any] = {}
    for part, roles in _PARTS.items():
        for role in roles:
            models[role] = load_model(model_files(parts[part], SMALL.record, role)).eval()
    made = new_checkpoint(SMALL, seed, roles=(LATENT_FLOW,), with_encoder=False)
    models[LATENT_FLOW] = made.models[LATENT_FLOW]
    encoded = []
    moments = ChannelMoments()
    for number in range(len(store)):
        encoded.append(_encode(models, store[number]))
        if not is_held_out(number):
            moments.add(encoded[-1].latent)
        tell(progress, number + 1, len(store))
    found = moments.statistics()
    if found is None:
        raise InputError(
            assets, "assets", "none can be used for training", "make more: recast recar assets"
        )
    record = PipelineRecord.of(
        {role: size.stem for role, size in SMALL.models.items()},
        SAMPLER,
        SAMPLER,
        tuple(found.mean.tolist()),
        tuple(found.std.tolist()),
        IMAGE_ENCODER,
    )
    save_checkpoint(model, record, models)
    _write_cache(store, encoded, model, cache)


@torch.no_grad()
def _encode(models: dict[str, Any], asset: TrainingAsset) -> Target:
    resolution = models[LATENT_ENCODER].config.resolution
    structure = models[STRUCTURE_ENCODER](occupancy([asset], resolution)).mean[0]
    latent = models[LATENT_ENCODER](voxel_features([asset])).mean.feats
    return Target(structure.numpy(), asset.coords.astype(np.int32), latent.numpy())


def _write_cache(store: AssetStore, encoded: list[Target], model: Path, cache: Path) -> None:
    source = ModelSource(model)
    record = CacheRecord(
        complete=False,
        vehicle_set=store.folder.absolute().name,
        model=source.record(),
        structure_sampler=SAMPLER,
        latent_sampler=SAMPLER,
        seed=0,
        retries=0,
        max_voxels=max(len(target.coords) for target in encoded),
    )
    write_json(cache / CACHE_FILE, record.model_dump(mode="json"))
    targets = TargetCache(cache, record, {}, {})
    per_voxel = SMALL.models[GAUSSIAN_DECODER].args["representation_config"]["num_gaussians"]
    for number, (path, target) in enumerate(zip(store.paths, encoded, strict=True)):
        targets.write_target(
            TargetRecord(
                id=path.stem,
                split="held-out" if is_held_out(number) else "train",
                kind=store[number].kind,
                seed=0,
                voxels=len(target.coords),
                gaussians=per_voxel * len(target.coords),
            ),
            target,
        )
    done = record.model_copy(update={"complete": True, "identities": len(encoded), "failures": 0})
    write_json(cache / CACHE_FILE, done.model_dump(mode="json"))


def train_part(
    part: Part,
    assets: Path,
    out: Path,
    console: Console,
    *,
    structure: Path | None,
    steps: int | None,
    seed: int,
) -> Report:
    """Train one part, showing its losses, then what it reaches on held-out assets.

    Raises:
        InputError: no assets, a folder of another training, a number of steps below one, or for
            the image encoder no trained structure encoder.
    """
    if steps is not None and steps < 1:
        raise InputError("`steps`", "value", f"is {steps}", "give 1 or more")
    steps = steps or STEPS[part]
    start = time.perf_counter()

    def watch(step: int, logs: dict[str, float]) -> None:
        values = "  ".join(f"{name} {value:.4g}" for name, value in logs.items())
        minutes = (time.perf_counter() - start) / 60
        console.print(f"{step}/{steps}  {minutes:.1f} min  {values}", highlight=False)

    if part == "structure":
        report = train_structure(assets, out, steps, seed, watch)
    elif part == "latent":
        report = train_latent(assets, out, steps, seed, watch)
    else:
        if structure is None:
            raise InputError(
                "`structure`",
                "folder",
                "is missing",
                "train the structure autoencoder first and name its folder",
            )
        report = train_image(assets, structure_encoder(structure), out, steps, seed, watch)
    for name, value in report.items():
        console.print(f"{name}: {value}", highlight=False)
    console.print(f"wrote {out / REPORT_FILE}", markup=False)
    return report


def structure_encoder(folder: Path) -> SparseStructureEncoder:
    """The encoder of a trained structure autoencoder, in evaluation mode.

    Raises:
        InputError: it was not trained to its end, or its files are at fault.
    """
    files = model_files(folder, SMALL.record, STRUCTURE_ENCODER)
    model = load_model(files)
    assert isinstance(model, SparseStructureEncoder)  # the role's class was checked
    return model.eval()
