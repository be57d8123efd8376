"""Caches of pseudo-targets, in the layout of the published training data, and their records.

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
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, read_record
from recast.core.table_files import read_npz
from recast.recar.screening import Decision, read_decisions
from recast.recar.vehicle_set import IdentityName, Split
from recast.recar.views import Text, write_arrays
from recast.trellis import MultiImageMode, SamplerSettings

Heading = Literal["any", "+x"]
CACHE_FORMAT = "recast-target-cache"
CACHE_VERSION = 1
CACHE_FILE = "cache.json"
RECORDS = "records"
PREVIEWS = "previews"
MEND = "build the cache again into a new folder"

VIEWS_DEG = (0.0, 180.0, 90.0, 270.0)
"""Azimuths of front, rear, left and right, the order in which the pipeline gets them."""

Azimuth = Annotated[FiniteFloat, Field(ge=0, lt=360)]


class CachedModelRecord(Record):
    """The model that made the targets.

    Attributes:
        name: name of its folder; the targets lie in folders of that name.
        sha256: SHA-256 of its files.
        resolution: R voxels a side of the decoded structure.
        latent_mean, latent_std: its normalisation of structured latents, one value a channel; the
            cache holds them raw.
    """

    name: Text
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    resolution: int = Field(ge=1, le=256)
    latent_mean: tuple[FiniteFloat, ...]
    latent_std: tuple[Annotated[FiniteFloat, Field(gt=0)], ...]


class FilterRecord(Record):
    """The quality filter: targets below the threshold are not used.

    Attributes:
        score: name of the score; None where there is no filter.
        threshold: least score. Only comparable among scores of the same name.
        weights: sha256 of the files the score was computed with, by what they are.
    """

    score: Text | None = None
    threshold: FiniteFloat | None = None
    weights: dict[str, str] = Field(default_factory=dict)


class CacheRecord(Record):
    """Contents of cache.json: what all targets have in common.

    Attributes:
        complete: False while targets are still being made.
        mode: how the views were used.
        views_deg: azimuths of the pictures that were used, in the order of `VIEWS_DEG`.
        structure_sampler, latent_sampler: samplers of structure and latents, as they ran.
        seed: seed from which each vehicle's seed is derived.
        retries: number of further seeds for a structure that is empty or too large.
        max_voxels: most voxels of a structure; more of them are too many.
        heading: direction in which vehicles of the model look, see `TargetSettings`; +x of caches
            that do not say, which assumed it.
        identities, failures: number of vehicles with a record, and of those among them without
            a target; None while targets are being made.
    """

    format: Literal["recast-target-cache"] = "recast-target-cache"
    version: int = CACHE_VERSION
    complete: bool
    vehicle_set: Text
    model: CachedModelRecord
    mode: MultiImageMode = "stochastic"
    views_deg: tuple[Azimuth, Azimuth, Azimuth, Azimuth] = VIEWS_DEG
    structure_sampler: SamplerSettings
    latent_sampler: SamplerSettings
    seed: int = Field(ge=0)
    retries: int = Field(ge=0)
    max_voxels: int = Field(ge=1)
    heading: Heading = "+x"
    filter: FilterRecord = FilterRecord()
    identities: int | None = None
    failures: int | None = None


class TargetRecord(Record):
    """Contents of records/ID.json: one vehicle. Written last: who has one is done.

    Attributes:
        seed: seed that made the target, after retries; that of the first try where it failed.
        voxels: number of active voxels; 0 where it failed.
        gaussians: number of decoded Gaussians; 0 where it failed.
        score: score of the quality filter; None where there is none, or it failed.
        score_flipped: score with front and rear exchanged, where the score can tell.
        parts: what the score is made of, by name.
        heading_deg: direction of its front, about z from +x; None where it was not searched.
        failure: reason why there is no target; None where there is one.
    """

    version: int = CACHE_VERSION
    id: IdentityName
    split: Split
    kind: Text
    colour: Text | None = None
    seed: int = Field(ge=0)
    voxels: int = Field(default=0, ge=0, le=256**3)
    gaussians: int = Field(default=0, ge=0, lt=2**63)
    score: FiniteFloat | None = None
    score_flipped: FiniteFloat | None = None
    parts: dict[str, FiniteFloat] = Field(default_factory=dict)
    heading_deg: Azimuth | None = None
    failure: Text | None = None


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
        records: records of the vehicles that are done, by id, sorted when the cache was opened.
    """

    folder: Path
    record: CacheRecord
    records: dict[str, TargetRecord]
    decisions: dict[str, Decision]

    @classmethod
    def open(cls, folder: str | Path, *, complete: bool = True) -> TargetCache:
        """Read the records of a cache; latents are read when asked for.

        Args:
            complete: whether to refuse one in the making.

        Raises:
            InputError: no such cache, one in the making, or a file of it that is wrong.
        """
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(folder, "target cache", "is missing", "check the path")
        record = read_record(folder / CACHE_FILE, CacheRecord, CACHE_VERSION, MEND, CACHE_FORMAT)
        if complete and not record.complete:
            problem = "is false: targets are still being made"
            mend = "run the command that makes them again; it resumes"
            raise InputError(folder / CACHE_FILE, "complete", problem, mend)
        records = read_records(folder)
        if record.complete and len(records) != record.identities:
            problem = f"{len(records)}, but cache.json counts {record.identities}"
            raise InputError(folder / RECORDS, "records", problem, "make the targets again")
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
            problem = (
                f"are {len(target.coords)} voxels up to {largest}, expected {voxels} below "
                f"{model.resolution}"
            )
            raise InputError(latent_path, "coords", problem, MEND)
        return target

    def write_target(
        self, record: TargetRecord, target: Target | None, preview: bytes | None = None
    ) -> None:
        """Add a vehicle; its record comes last, so that a kill leaves it either done or to do.

        Args:
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
