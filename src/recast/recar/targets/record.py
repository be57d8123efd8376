"""The records of a cache of pseudo-targets: cache.json, and records/ID.json of every vehicle."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from recast.recar.record import IdentityName, Split, Text
from recast.recar.targets.settings import Heading
from recast.records import Record
from recast.trellis import MultiImageMode, SamplerSettings

CACHE_FORMAT = "recast-target-cache"
CACHE_VERSION = 1
CACHE_FILE = "cache.json"
RECORDS = "records"
PREVIEWS = "previews"
MEND = "build the cache again into a new folder"

VIEWS_DEG = (0.0, 180.0, 90.0, 270.0)
"""Azimuths of front, rear, left and right, the order in which the pipeline gets them."""

Azimuth = Annotated[FiniteFloat, Field(ge=0, lt=360)]


class ModelRecord(Record):
    """The model that made the targets.

    Attributes:
        name: of its folder; the targets lie in folders of that name.
        sha256: of its files, see `model_hash`.
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
        vehicle_set: name of the set.
        model: what made the targets.
        mode: how the views were used.
        views_deg: azimuths of the pictures that were used, in the order of `VIEWS_DEG`.
        structure_sampler, latent_sampler: as they ran.
        seed: from which each vehicle's seed is derived.
        retries: further seeds for a structure that is empty or too large.
        max_voxels: more of them are too many.
        heading: where vehicles of the model look, see `TargetSettings`; +x of caches that do not
            say, which assumed it.
        filter: the quality filter.
        identities, failures: vehicles with a record, and those of them without a target; None
            while targets are being made.
    """

    format: Literal["recast-target-cache"] = "recast-target-cache"
    version: int = CACHE_VERSION
    complete: bool
    vehicle_set: Text
    model: ModelRecord
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
        id: of the vehicle in its set.
        split: of the vehicle.
        kind, colour: labels of the vehicle, for people.
        seed: the one that made the target, after retries; of the first try where it failed.
        voxels: active ones; 0 where it failed.
        gaussians: decoded; 0 where it failed.
        score: of the quality filter; None where there is none, or it failed.
        score_flipped: score with front and rear exchanged, where the score can tell.
        parts: what the score is made of, by name.
        heading_deg: direction of its front, about z from +x; None where it was not searched.
        failure: why there is no target; None where there is one.
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
