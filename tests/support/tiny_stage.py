"""A stage small enough to train in a test: golden networks, a rectangle set, made-up targets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from recast.core.files import write_json
from recast.recar import begin_set, finish_set, regular_azimuths, write_identity
from recast.recar.target_cache import (
    CachedModelRecord,
    CacheRecord,
    Target,
    TargetCache,
    TargetRecord,
)
from recast.recar.training import StageRequest, train_stage
from recast.recar.training_config import StageConfig
from recast.recar.vehicle_set import IdentityRecord, SetRecord
from recast.trellis import ImageTo3D, SamplerSettings
from support.trellis import golden_tensors
from support.trellis_folder import write_golden_model

VIEWS, PIXELS = 3, 40


@dataclass(frozen=True)
class TinyStage:
    """Folders of a stage's inputs."""

    model: Path
    targets: Path
    pictures: Path

    def request(self, out: Path, **changes: Any) -> StageRequest:
        """A request; `changes` replace members of the configuration, "structure" and "latent"
        members of theirs."""
        return StageRequest(tiny_config(**changes), self.model, self.targets, self.pictures, out)


def tiny_config(**changes: Any) -> StageConfig:
    """Six steps of each flow, a checkpoint after every second."""
    flow = {
        "steps": 6,
        "lr": 1e-3,
        "ema_decay": 0.9,
        "checkpoint_every": 2,
        "log_every": 2,
        "seed": 3,
    }
    values: dict[str, Any] = {
        "name": "tiny",
        "objective": {"batch": 2},
        "probe": 2,
        "sheet_every": 0,
        "sheet_vehicles": 1,
    }
    for name in ("structure", "latent"):
        given = changes.pop(name, {})
        values[name] = None if given is None else flow | given
    return StageConfig.model_validate(values | changes)


def write_tiny_stage(root: Path, identities: int = 6) -> TinyStage:
    """Write model, set and cache; the last two vehicles are held out."""
    folders = TinyStage(write_golden_model(root / "model"), root / "cache", root / "set")
    names = [f"car-{index}" for index in range(identities)]
    splits = {n: "held-out" if i >= identities - 2 else "train" for i, n in enumerate(names)}
    _write_set(folders.pictures, splits)
    _write_targets(folders, splits)
    return folders


def _write_set(folder: Path, splits: dict[str, Any]) -> None:
    record = SetRecord(
        complete=True,
        name="rectangles",
        licence="CC0-1.0",
        source="drawn by the tests",
        identities=len(splits),
        azimuths_deg=regular_azimuths(VIEWS),
        elevation_deg=15.0,
        fov_deg=40.0,
        width=PIXELS,
        height=PIXELS,
        split_seed=0,
        held_out_share=0.3,
        generator=None,
    )
    begin_set(folder, record, list(splits))
    for index, (name, split) in enumerate(splits.items()):
        one = IdentityRecord(
            id=name,
            kind="sedan",
            category="car",
            colour="red",
            size=(4.5, 1.8, 1.5),
            distance_m=8.0,
            split=split,
        )
        pictures = []
        for view in range(VIEWS):
            picture = np.zeros((PIXELS, PIXELS, 4), np.uint8)
            picture[10:30, 4 + 2 * view : 36] = (200, 40 * view, 30 * index, 255)
            pictures.append(picture)
        write_identity(folder, record, one, pictures)
    finish_set(folder, record)


def _write_targets(folders: TinyStage, splits: dict[str, Any]) -> None:
    model = ImageTo3D.load(folders.model, device="cpu")
    case = golden_tensors("train_slat_flow")
    mean, std = model.checkpoint.record.slat_statistics
    record = CacheRecord(
        complete=True,
        vehicle_set="rectangles",
        model=CachedModelRecord(
            name="golden",
            sha256="0" * 64,
            resolution=model.latent_flow.config.resolution,
            latent_mean=mean,
            latent_std=std,
        ),
        structure_sampler=SamplerSettings(),
        latent_sampler=SamplerSettings(),
        seed=0,
        retries=0,
        max_voxels=1000,
        identities=len(splits),
        failures=0,
    )
    write_json(folders.targets / "cache.json", record.model_dump(mode="json"))
    cache = TargetCache(folders.targets, record, {}, {})
    coords = case["coords"][case["coords"][:, 0] == 0, 1:].int()
    for index, (name, split) in enumerate(splits.items()):
        generator = torch.Generator().manual_seed(index)
        kept = coords[torch.randperm(len(coords), generator=generator)[: 40 + 10 * index]]
        kept = kept[np.lexsort(kept.numpy().T[::-1])]
        cache.write_target(
            TargetRecord(id=name, split=split, kind="sedan", seed=0, voxels=len(kept)),
            Target(
                torch.randn(*model.structure_shape, generator=generator).numpy(),
                kept.numpy(),
                torch.randn(len(kept), model.latent_channels, generator=generator).numpy(),
            ),
        )


def train_quietly(request: StageRequest) -> None:
    """Train in a process of its own, which a test may kill."""
    torch.set_num_threads(1)
    train_stage(request, console=Console(quiet=True))
