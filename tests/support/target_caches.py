"""Small caches of pseudo-targets: boxes of voxels with random latents."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from recast.core import files
from recast.recar.target_cache import (
    CachedModelRecord,
    CacheRecord,
    FilterRecord,
    Target,
    TargetCache,
    TargetRecord,
)
from recast.trellis import SamplerSettings

RESOLUTION = 16


def box_target(
    seed: int, *, resolution: int = RESOLUTION, side: int = 4, channels: int = 8
) -> Target:
    """A hollow box of voxels, longer than wide, with random latents."""
    rng = np.random.default_rng(seed)
    shape = np.array([resolution - 2, resolution // 2, resolution // 2 - seed % 2])
    start = (resolution - shape) // 2
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    shell = np.any((grid == 0) | (grid == shape - 1), axis=1)
    coords = (grid[shell] + start).astype(np.int32)
    return Target(
        rng.normal(size=(channels, side, side, side)).astype(np.float32),
        coords,
        rng.normal(1.0, 2.0, (len(coords), channels)).astype(np.float32),
    )


def cache_record(identities: int, failures: int = 0, **changes: object) -> CacheRecord:
    """A complete cache of a model called "tiny"; scores count from 0.5 on."""
    model = CachedModelRecord(
        name="tiny",
        sha256="0" * 64,
        resolution=RESOLUTION,
        latent_mean=(1.0,) * 8,
        latent_std=(2.0,) * 8,
    )
    fields: dict[str, object] = {
        "complete": True,
        "vehicle_set": "boxes",
        "model": model,
        "structure_sampler": SamplerSettings(steps=4),
        "latent_sampler": SamplerSettings(steps=4),
        "seed": 0,
        "retries": 0,
        "max_voxels": 4096,
        "filter": FilterRecord(score="made-up", threshold=0.5),
        "identities": identities,
        "failures": failures,
    }
    return CacheRecord.model_validate(fields | changes)


def write_cache(
    folder: Path,
    scores: Sequence[float | None] = (0.9, 0.8, 0.2, None),
    *,
    ids: Sequence[str] | None = None,
    channels: int = 8,
    side: int = 4,
    **changes: object,
) -> TargetCache:
    """A complete cache, read again: one vehicle a score (car-0, ...); None is a failure.

    The second vehicle is held out. Previews are plain pictures of 8x8 pixels.
    """
    ids = ids or [f"car-{index}" for index in range(len(scores))]
    record = cache_record(len(scores), sum(score is None for score in scores), **changes)
    folder.mkdir(parents=True, exist_ok=True)
    cache = TargetCache(folder, record, {}, {})
    for index, (identity, score) in enumerate(zip(ids, scores, strict=True)):
        target = None
        if score is not None:
            target = box_target(
                index, resolution=record.model.resolution, side=side, channels=channels
            )
        one = TargetRecord(
            id=identity,
            split="held-out" if index == 1 else "train",
            kind="sedan",
            colour="red",
            seed=100 + index,
            voxels=0 if target is None else len(target.coords),
            score=score,
            failure="the sampled structure is empty" if target is None else None,
        )
        cache.write_target(one, target, None if target is None else _preview(index))
    files.write_json(folder / "cache.json", record.model_dump(mode="json"))
    return TargetCache.open(folder)


def _preview(index: int) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (8, 8), (40 * index % 256, 90, 120)).save(stream, "PNG")
    return stream.getvalue()
