"""Caches of pseudo-targets, in the layout of the published training data.

CACHE/cache.json
CACHE/ss_latents/MODEL/ID.npz     mean (C, r, r, r) float32
CACHE/latents/MODEL/ID.npz        feats (T, C) float32, coords (T, 3) uint8
CACHE/previews/ID.png             contact sheet for people
CACHE/records/ID.json             written last
CACHE/screening.csv               decisions of a person, if any: `recast.recar.screening`
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import read_record
from recast.recar.screening import Decision, read_decisions
from recast.recar.targets.cache_records import (
    CACHE_FILE,
    CACHE_FORMAT,
    CACHE_VERSION,
    MEND,
    PREVIEWS,
    RECORDS,
    CacheRecord,
    TargetRecord,
)
from recast.recar.vehicle_set import Split
from recast.recar.views import write_arrays
from recast.tables import read_npz

_MOST_BYTES = 1 << 28  # most of the arrays of a target; published ones have 2 MB
STRUCTURES = "ss_latents"
LATENTS = "latents"
_REMAKE = "make the target again: remove its record and run the command that made it"


@dataclass(frozen=True)
class Target:
    """What the multi-image pipeline made of one vehicle (S, P and Z of the paper, section 2).

    Attributes:
        structure: (C, r, r, r) float32 sparse-structure latent as sampled; axes x, y, z.
        coords: (T, 3) int32 active voxels x, y, z in [0, R), in lexicographic order.
        latent: (T, C) float32 structured latent on them, raw: not normalised.

    Raises:
        ValueError: other shapes, no voxel, voxels in another order or twice, or values that are
            not finite.
    """

    structure: NDArray[np.float32]
    coords: NDArray[np.int32]
    latent: NDArray[np.float32]

    def __post_init__(self) -> None:
        shape = self.structure.shape
        if len(shape) != 4 or len(set(shape[1:])) != 1:
            raise ValueError(f"structure latent of shape {shape}, expected (C, r, r, r)")
        count = len(self.coords)
        if self.coords.shape != (count, 3) or self.latent.ndim != 2 or len(self.latent) != count:
            raise ValueError(
                f"coords {self.coords.shape} latent {self.latent.shape}, expected (T, 3), (T, C)"
            )
        if count == 0:
            raise ValueError("holds no active voxels")
        if self.coords.min() < 0 or not _rising(self.coords):
            raise ValueError("coords are negative, out of order or repeated")
        if not (np.isfinite(self.structure).all() and np.isfinite(self.latent).all()):
            raise ValueError("holds values that are not finite")


def _rising(coords: NDArray[np.int32]) -> bool:
    """Whether rows (T, 3) ascend strictly, the first column first."""
    x, y, z = np.diff(coords.astype(np.int64), axis=0).T
    return bool(np.all((x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z > 0))))))


@dataclass
class TargetCache:
    """Targets of the vehicles of a set.

    Attributes:
        folder: folder of the cache.
        record: contents of cache.json.
        records: records of the vehicles that are done, by id, sorted when the cache was opened.
        decisions: decisions of a person, by id.
    """

    folder: Path
    record: CacheRecord
    records: dict[str, TargetRecord]
    decisions: dict[str, Decision]

    @classmethod
    def open(cls, folder: str | Path, *, complete: bool = True) -> TargetCache:
        """Read the records of a cache; latents are read when asked for.

        Args:
            folder: folder of the cache.
            complete: whether to refuse one in the making.

        Raises:
            InputError: no such cache, one in the making, or a file of it that is wrong.
        """
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(folder, "target cache", "is missing", "check the path")
        record = read_record(folder / CACHE_FILE, CacheRecord, CACHE_VERSION, MEND, CACHE_FORMAT)
        if complete and not record.complete:
            raise InputError(
                folder / CACHE_FILE,
                "complete",
                "is false: targets are still being made",
                "run the command that makes them again; it resumes",
            )
        records = read_records(folder)
        if record.complete and len(records) != record.identities:
            raise InputError(
                folder / RECORDS,
                "records",
                f"{len(records)}, but cache.json counts {record.identities}",
                "make the targets again",
            )
        decisions = read_decisions(folder, records)
        return cls(folder, record, dict(sorted(records.items())), decisions)

    def ids(self, split: Split | None = None, accepted_only: bool = True) -> tuple[str, ...]:
        """Vehicles that have a target, sorted.

        Args:
            split: split of the vehicles; None takes all.
            accepted_only: whether to leave out what a person rejected and what is below the
                threshold.
        """
        return tuple(
            one.id
            for one in self.records.values()
            if one.failure is None
            and split in (None, one.split)
            and (not accepted_only or self.accepted(one.id))
        )

    def accepted(self, identity: str) -> bool:
        """Whether a target is used: neither rejected nor below the threshold."""
        record = self.records[identity]
        if record.failure is not None or self.decisions.get(identity) == "no":
            return False
        threshold, score = self.record.filter.threshold, record.score
        return threshold is None or (score is not None and score >= threshold)

    def target(self, identity: str) -> Target:
        """The target of a vehicle.

        Raises:
            KeyError: the cache has no target of it.
            InputError: a file is missing, cut short or of another layout.
        """
        if identity not in self.records or self.records[identity].failure is not None:
            raise KeyError(identity)
        structure_path, latent_path = self._paths(identity)
        with files.disk_errors(structure_path):
            structure = read_npz(structure_path, _REMAKE, ("mean",), _MOST_BYTES)["mean"]
            latent = read_npz(latent_path, _REMAKE, ("feats", "coords"), _MOST_BYTES)
        model = self.record.model
        try:
            target = Target(
                structure.astype(np.float32, casting="same_kind", copy=False),
                latent["coords"].astype(np.int32, casting="same_kind"),
                latent["feats"].astype(np.float32, casting="same_kind", copy=False),
            )
            if target.latent.shape[1] != len(model.latent_mean):
                raise ValueError(f"latent of {target.latent.shape[1]} channels")
        except (TypeError, ValueError) as error:
            raise InputError(latent_path, "arrays", str(error), MEND) from None
        voxels, largest = self.records[identity].voxels, target.coords.max()
        if len(target.latent) != voxels or largest >= model.resolution:
            raise InputError(
                latent_path,
                "coords",
                f"are {len(target.coords)} voxels up to {largest}, expected {voxels} below "
                f"{model.resolution}",
                MEND,
            )
        return target

    def write_target(
        self, record: TargetRecord, target: Target | None, preview: bytes | None = None
    ) -> None:
        """Add a vehicle; its record comes last, so that a kill leaves it either done or to do.

        Args:
            record: record of the vehicle.
            target: target of the vehicle; None where there is none.
            preview: contact sheet as a PNG.

        Raises:
            ValueError: record and target do not agree.
            InputError: the disk is full.
        """
        voxels = 0 if target is None else len(target.coords)
        if (target is None) != (record.failure is not None) or voxels != record.voxels:
            raise ValueError(f"{record.id}: {voxels} voxels contradict the record {record}")
        if target is not None:
            structure_path, latent_path = self._paths(record.id)
            write_arrays(structure_path, mean=target.structure.astype(np.float32))
            coords = target.coords.astype(np.uint8)
            write_arrays(latent_path, feats=target.latent.astype(np.float32), coords=coords)
        if preview is not None:
            files.write_bytes(self.preview_path(record.id), preview)
        path = self.folder / RECORDS / f"{record.id}.json"
        files.write_json(path, record.model_dump(mode="json"))
        self.records[record.id] = record

    def preview_path(self, identity: str) -> Path:
        """Where the contact sheet of a vehicle lies."""
        return self.folder / PREVIEWS / f"{identity}.png"

    def _paths(self, identity: str) -> tuple[Path, Path]:
        model = self.record.model.name
        return (
            self.folder / STRUCTURES / model / f"{identity}.npz",
            self.folder / LATENTS / model / f"{identity}.npz",
        )


def read_records(folder: Path) -> dict[str, TargetRecord]:
    """The records of all vehicles that are done, by id.

    Raises:
        InputError: a record that is wrong, or under another name.
    """
    records = {}
    for path in sorted((folder / RECORDS).glob("[!.]*.json")):
        one = read_record(path, TargetRecord, CACHE_VERSION, MEND)
        if one.id != path.stem:
            raise InputError(path, "id", f"is {one.id!r}", "name the file after its vehicle")
        records[one.id] = one
    return records
