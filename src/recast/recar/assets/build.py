"""A folder of training assets, made by several processes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from recast.crews import crew_of
from recast.errors import InputError
from recast.recar.assets.asset import write_asset
from recast.records import Record, read_record
from recast.storage import alone_in, write_json

RECORD_FILE = "assets.json"
_MEND = "name a new folder, or make the assets again"


class AssetsRecord(Record):
    """What all assets of a folder share, as written to `assets.json`.

    Attributes:
        seed: of everything random; asset i depends on seed and i alone.
        shape_every: every n-th asset is another shape than a vehicle, 0 none.
        resolution: voxels a side.
        crops, around, pixels: pictures of each, see `views.sample_views`.
    """

    format: Literal["recast-training-assets"] = "recast-training-assets"
    version: Literal[1] = 1
    seed: int = Field(default=0, ge=0)
    shape_every: int = Field(default=4, ge=0)
    resolution: int = Field(default=32, ge=8, le=256)
    crops: int = Field(default=8, ge=1)
    around: int = Field(default=16, ge=1)
    pixels: int = Field(default=128, ge=32)


def make_assets(
    out: Path,
    count: int,
    record: AssetsRecord,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Make the first `count` assets of a seed; those that are there already are kept.

    Raises:
        InputError: `out` holds assets of other settings, embreex is not installed, a count or a
            number of workers below one, or the disk is full.
    """
    from recast.synthetic.rendering import require_embree

    for option, value in (("--count", count), ("--workers", workers)):
        if value < 1:
            raise InputError(option, "value", f"is {value}", "give 1 or more")
    require_embree()
    path = out / RECORD_FILE
    if path.exists():
        found = read_record(path, AssetsRecord, 1, _MEND, record.format)
        if found != record:
            raise InputError(path, "settings", "differ from those asked for", _MEND)
    else:
        write_json(path, record.model_dump(mode="json"))
    left = [i for i in range(count) if not asset_path(out, i).exists()]
    done, indices = count - len(left), iter(left)
    if progress is not None:
        progress(done, count)
    crew = crew_of(min(workers, len(left)) or 1)
    with alone_in(out):
        for _ in crew(_start, (out, record), lambda: next(indices, None), "finished assets"):
            done += 1
            if progress is not None:
                progress(done, count)


def _start(worker: int, out: Path, record: AssetsRecord) -> Callable[[int], None]:
    del worker  # makes no difference
    return partial(_make, out, record=record)


def asset_path(folder: Path, index: int) -> Path:
    """Where an asset lies."""
    return folder / f"asset-{index:05d}.npz"


def _make(out: Path, index: int, record: AssetsRecord) -> None:
    from recast.recar.assets.synthesis import AssetSettings, make_asset
    from recast.synthetic.vehicles import sample_shape, sample_vehicle

    rng = np.random.default_rng([record.seed, index])
    shape = record.shape_every and index % record.shape_every == record.shape_every - 1
    model = sample_shape(rng) if shape else sample_vehicle(rng)
    settings = AssetSettings(record.resolution, record.crops, record.around, record.pixels)
    write_asset(asset_path(out, index), make_asset(model, settings, rng))
