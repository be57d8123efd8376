"""A folder of photographs of sampled designs, made a shard at a time, and its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from recast.actors.parametric.codec import DesignCodec
from recast.core.diagnostics import Progress, tell
from recast.core.errors import InputError
from recast.core.files import alone_in, atomic_file, write_json
from recast.core.records import Record, read_record
from recast.core.workers import worker_pool
from recast_tools.parametric.photographs import photographs

RECORD_FILE = "designs.json"
HELD_OUT_EVERY = 20
_MEND = "choose a new folder, or make the designs again"


class DesignsRecord(Record):
    """What all shards of a folder share, as written to `designs.json`.

    Attributes:
        seed: seed of everything random; a shard depends on seed and its index alone.
        vehicles: number of vehicles of a shard.
        views: number of photographs of a vehicle.
        fields: the codec's record; designs of another version do not mix.
    """

    format: Literal["recast-designs"] = "recast-designs"
    version: Literal[1] = 1
    seed: int = Field(default=0, ge=0)
    vehicles: int = Field(default=80, ge=1)
    views: int = Field(default=3, ge=1)
    fields: str = DesignCodec().record


def make_designs(
    out: Path,
    shards: int,
    record: DesignsRecord,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> None:
    """Make the first shards of a seed; those that are there already are kept.

    Raises:
        InputError: `out` holds designs of other settings, or a number below one.
    """
    for option, value in (("`shards`", shards), ("`workers`", workers)):
        if value < 1:
            raise InputError(option, "value", f"is {value}", "give 1 or more")
    path = out / RECORD_FILE
    if path.exists():
        found = read_record(path, DesignsRecord, 1, _MEND, record.format)
        if found != record:
            raise InputError(path, "settings", "differ from the requested ones", _MEND)
    else:
        write_json(path, record.model_dump(mode="json"))
    left = [i for i in range(shards) if not _shard(out, i).exists()]
    done, indices = shards - len(left), iter(left)
    tell(progress, done, shards)
    pool = worker_pool(min(workers, len(left)) or 1)
    with alone_in(out):
        for _ in pool(_start, (out, record), lambda: next(indices, None), "finished shards"):
            done += 1
            tell(progress, done, shards)


def _shard(folder: Path, index: int) -> Path:
    return folder / f"shard-{index:04d}.npz"


def _start(_: int, out: Path, record: DesignsRecord) -> Callable[[int], None]:
    return partial(_make, out, record=record)


def _make(out: Path, index: int, record: DesignsRecord) -> None:
    rng, codec = np.random.default_rng([record.seed, index]), DesignCodec()
    rows = [row for _ in range(record.vehicles) for row in photographs(rng, record.views)]
    coded = [codec.encode(row.vehicle) for row in rows]
    with atomic_file(_shard(out, index)) as partial_path, partial_path.open("wb") as stream:
        np.savez(
            stream,
            planes=np.stack([row.condition.planes for row in rows]),
            geometry=np.stack([row.condition.geometry for row in rows]),
            numbers=np.stack([numbers for numbers, _ in coded]).astype(np.float32),
            choices=np.stack([choices for _, choices in coded]).astype(np.int64),
        )


@dataclass(frozen=True)
class DesignRows:
    """Photographs and what is to be read from them, N rows."""

    planes: Tensor  # (N, pixels, 5) uint8
    geometry: Tensor  # (N, G)
    numbers: Tensor  # (N, numbers)
    choices: Tensor  # (N, choices)

    def chosen(self, rows: NDArray[np.integer] | slice) -> DesignRows:
        """Some of the rows."""
        which = rows if isinstance(rows, slice) else torch.from_numpy(rows)
        parts = (self.planes, self.geometry, self.numbers, self.choices)
        return DesignRows(*(part[which] for part in parts))


def read_rows(folder: Path) -> tuple[DesignRows, DesignRows]:
    """Rows to train on, and those held out: one shard in twenty, the first one among them.

    Raises:
        InputError: fewer than two shards, or designs of another version.
    """
    record = read_record(folder / RECORD_FILE, DesignsRecord, 1, _MEND, "recast-designs")
    DesignCodec().check(record.fields, folder / RECORD_FILE)
    paths = sorted(folder.glob("shard-*.npz"))
    if len(paths) < 2:
        problem = f"has {len(paths)} shards, at least two are needed"
        raise InputError(folder, "designs", problem, "make more: recast recar designs")
    held = [path for path in paths if int(path.stem[-4:]) % HELD_OUT_EVERY == 0] or paths[:1]
    return _joined([path for path in paths if path not in held]), _joined(held)


def _joined(paths: list[Path]) -> DesignRows:
    parts: dict[str, list[NDArray[np.generic]]] = {}
    for path in paths:
        with np.load(path) as shard:
            for name in ("planes", "geometry", "numbers", "choices"):
                parts.setdefault(name, []).append(shard[name])
    return DesignRows(*(torch.from_numpy(np.concatenate(rows)) for rows in parts.values()))
