"""How targets are made, by which model, and their records: cache.json, records/ID.json."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat

from recast.core.records import Record
from recast.recar.set_records import IdentityName, Split, Text
from recast.trellis import ImageTo3D, MultiImageMode, SamplerSettings
from recast.trellis.checkpoints import BACKBONE_FOLDER
from recast.trellis.model_files import (
    GENERATION_ROLES,
    LATENT_FLOW,
    PIPELINE_FILE,
    PipelineRecord,
    model_files,
    read_pipeline,
)

FilterKind = Literal["agreement", "aesthetic", "none"]
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


class FilterSettings(Record):
    """The quality filter.

    Attributes:
        kind: "aesthetic" is that of the paper, the Improved Aesthetic Predictor; "agreement" a
            stand-in for small models, see `AgreementScore`; "none" scores nothing.
        threshold: least score of a target that is used; None takes that of the score.
        predictor: weights of the predictor, such as sac+logos+ava1-l14-linearMSE.pth.
        clip: folder of CLIP ViT-L/14 as Hugging Face has it.
    """

    kind: FilterKind = "agreement"
    threshold: FiniteFloat | None = None
    predictor: Path | None = None
    clip: Path | None = None


class TargetSettings(Record):
    """How targets are made; the defaults are the paper's, where it says something.

    Attributes:
        seed: seed from which the seed of every vehicle is derived.
        mode: mode of the multi-image pipeline.
        structure, latent: samplers of structure and latents; None takes those of the checkpoint.
        retries: number of further seeds for a structure that is empty or too large.
        max_voxels: most voxels of a structure, more of them are too many; None takes 8 R^2, the
            published limit.
        heading: direction in which vehicles of the model look: along +x, as those of models that
            were trained so do, and a target that does not is one that failed; or any way, as those
            of the published ones, which is then found by the pictures.
        filter: quality filter.
    """

    seed: int = Field(default=0, ge=0)
    mode: MultiImageMode = "stochastic"
    structure: SamplerSettings | None = None
    latent: SamplerSettings | None = None
    retries: int = Field(default=3, ge=0, le=1000)
    max_voxels: int | None = Field(default=None, ge=1)
    heading: Heading = "any"
    filter: FilterSettings = FilterSettings()


def identity_seed(seed: int, identity: str) -> int:
    """Seed of the noise of one vehicle in [0, 2^31): it depends on no other vehicle.

    Retries count on from it; the seeds of two vehicles are rarely near each other.
    """
    digest = hashlib.sha256(f"{seed}/{identity}".encode()).digest()
    return int.from_bytes(digest[:8], "big") % 2**31


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
        vehicle_set: name of the set.
        model: what made the targets.
        mode: how the views were used.
        views_deg: azimuths of the pictures that were used, in the order of `VIEWS_DEG`.
        structure_sampler, latent_sampler: samplers of structure and latents, as they ran.
        seed: seed from which each vehicle's seed is derived.
        retries: number of further seeds for a structure that is empty or too large.
        max_voxels: most voxels of a structure; more of them are too many.
        heading: direction in which vehicles of the model look, see `TargetSettings`; +x of caches
            that do not say, which assumed it.
        filter: the quality filter.
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
        kind, colour: labels of the vehicle, for people.
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


@dataclass(frozen=True)
class ModelSource:
    """A model folder in the published layout; every process loads a model of its own from it.

    Attributes:
        folder: folder with pipeline.json and ckpts/.
        image_encoder: weights of the published image encoder, where the folder has none.
        device: device to compute on; None takes CUDA where there is some, one device a process in
            turn.
    """

    folder: Path
    image_encoder: Path | None = None
    device: str | None = None

    def load(self, device: str | None = None) -> ImageTo3D:
        """The model, on `device` or its own.

        Raises:
            InputError: see `ImageTo3D.load`.
        """
        return ImageTo3D.load(
            self.folder, device=device or self.device, image_encoder=self.image_encoder
        )

    def record(self) -> CachedModelRecord:
        """What the cache says of the model, all its files read for the hash.

        Raises:
            InputError: no such folder, or a file is missing or wrong.
        """
        pipeline = read_pipeline(self.folder)
        config: Any = model_files(self.folder, pipeline, LATENT_FLOW).meta_model().config
        mean, std = pipeline.slat_statistics
        return CachedModelRecord(
            name=self.folder.absolute().name,
            sha256=file_hash(self._files(pipeline)),
            resolution=int(config.resolution),
            latent_mean=mean,
            latent_std=std,
        )

    def pipeline(self) -> PipelineRecord:
        """pipeline.json, for its samplers."""
        return read_pipeline(self.folder)

    def _files(self, pipeline: PipelineRecord) -> Iterator[Path]:
        yield self.folder / PIPELINE_FILE
        roles = list(GENERATION_ROLES)
        if pipeline.encoder_role is not None:
            roles.append(pipeline.encoder_role)
        for role in roles:
            files = model_files(self.folder, pipeline, role)
            yield from (files.config, files.weights)
        if pipeline.encoder_role is None:
            backbone = self.image_encoder or self.folder / BACKBONE_FOLDER
            inside = backbone.rglob("*") if backbone.is_dir() else iter([backbone])
            yield from sorted(path for path in inside if path.is_file())


def file_hash(paths: Iterator[Path]) -> str:
    """SHA-256 of the contents of files, one after the other with their lengths before them."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.stat().st_size.to_bytes(8, "big"))
        with path.open("rb") as stream:
            while block := stream.read(1 << 22):
                digest.update(block)
    return digest.hexdigest()
