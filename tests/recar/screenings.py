"""Small caches of pseudo-targets to screen: records and contact sheets, no latents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from recast.core import files
from recast.recar.targets import (
    CachedModelRecord,
    CacheRecord,
    FilterRecord,
    TargetCache,
    TargetRecord,
)
from recast.trellis import SamplerSettings

SCORES: dict[str, tuple[float | None, float | None]] = {
    "car-0": (4.8, 4.1),
    "car-1": (4.2, 5.0),
    "car-2": (4.6, None),
    "car-10": (3.0, 3.1),
}


def write_cache(
    folder: Path, scores: Mapping[str, tuple[float | None, float | None]] = SCORES
) -> TargetCache:
    """A cache with targets of these scores, as they are and turned, and one failed vehicle."""
    record = CacheRecord(
        complete=True,
        vehicle_set="rectangles",
        model=CachedModelRecord(
            name="tiny", sha256="0" * 64, resolution=8, latent_mean=(0.0,), latent_std=(1.0,)
        ),
        structure_sampler=SamplerSettings(),
        latent_sampler=SamplerSettings(),
        seed=0,
        retries=0,
        max_voxels=100,
        filter=FilterRecord(score="likeness", threshold=4.5),
        identities=len(scores) + 1,
        failures=1,
    )
    files.write_json(folder / "cache.json", record.model_dump(mode="json"))
    for name, (score, turned) in scores.items():
        one = target_record(name).model_copy(
            update={"voxels": 9, "score": score, "score_flipped": turned}
        )
        files.write_json(folder / "records" / f"{name}.json", one.model_dump(mode="json"))
        files.write_bytes(folder / "previews" / f"{name}.png", sheet(len(name)))
    failed = target_record("failed").model_copy(update={"failure": "empty structure"})
    files.write_json(folder / "records" / "failed.json", failed.model_dump(mode="json"))
    return TargetCache.open(folder)


def target_record(name: str) -> TargetRecord:
    return TargetRecord(id=name, split="train", kind="sedan", colour="red", seed=1)


def sheet(shade: int) -> bytes:
    """A PNG of 4 x 3 tiles."""
    written, data = cv2.imencode(".png", np.full((12, 16, 3), 20 * shade, np.uint8))
    assert written
    return data.tobytes()
