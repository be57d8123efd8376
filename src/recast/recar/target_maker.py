"""One target from one vehicle: settings, the model, and what a process of the builder does."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from pydantic import Field, FiniteFloat

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.images import draw_text
from recast.core.records import Record
from recast.logs.images import encode
from recast.recar.target_cache import CachedModelRecord, FilterRecord, Heading, Target, TargetRecord
from recast.recar.target_quality import (
    AestheticScore,
    AgreementScore,
    Quality,
    QualityScore,
    TargetCandidate,
    file_hash,
    weight_hashes,
)
from recast.recar.target_views import (
    EncodedView,
    find_heading,
    of_picture,
    render,
    resized,
    turned,
)
from recast.recar.vehicle_set import Split
from recast.trellis import (
    GeneratedVehicle,
    GenerationLimits,
    ImageTo3D,
    MultiImageMode,
    SamplerSettings,
    generate,
)
from recast.trellis.checkpoints import (
    BACKBONE_FOLDER,
    GENERATION_ROLES,
    PipelineRecord,
    read_pipeline,
)
from recast.trellis.model_files import LATENT_FLOW, PIPELINE_FILE, model_files

FilterKind = Literal["agreement", "aesthetic", "none"]


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


TILE = 192
"""Pixels a side of a tile."""

_GREY = 0.55  # behind the vehicles, so that black ones are seen too
_COLUMNS = (0, 2, 1, 3)  # front, left, rear, right: the way around the vehicle
_CAPTIONS = ("front", "left", "rear", "right")


@dataclass(frozen=True)
class VehicleTask:
    """A vehicle to make a target of.

    Attributes:
        views: front, rear, left and right view; fewer where one could not be read.
    """

    id: str
    split: Split
    kind: str
    colour: str | None
    views: tuple[EncodedView, ...]
    failure: str | None = None


@dataclass(frozen=True)
class TargetOutcome:
    """What became of a task; `target` and `preview` are None where it failed."""

    record: TargetRecord
    target: Target | None = None
    preview: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True)
class TargetMaker:
    """Makes targets with a model, and a score if there is a quality filter."""

    _model: ImageTo3D
    _settings: TargetSettings
    _score: QualityScore | None

    @classmethod
    def load(
        cls, source: ModelSource, settings: TargetSettings, device: str | None = None
    ) -> TargetMaker:
        """Read the model and the weights of the score.

        Raises:
            InputError: one of them cannot be read.
        """
        return cls(source.load(device), settings, open_score(settings.filter))

    def make(self, task: VehicleTask) -> TargetOutcome:
        """The target of a vehicle, judged, with its contact sheet; or why there is none."""
        seed = identity_seed(self._settings.seed, task.id)
        blank = TargetRecord(
            id=task.id, split=task.split, kind=task.kind, colour=task.colour, seed=seed
        )
        if task.failure is not None:
            return TargetOutcome(blank.model_copy(update={"failure": task.failure}))
        try:
            pictures = _pictures(task.views)
            made = self._generate(pictures, seed, task.id)
        except InputError as error:
            return TargetOutcome(blank.model_copy(update={"failure": error.problem}))
        target = Target(
            made.structure.float().numpy(),
            made.coords.numpy().astype(np.int32),
            made.latent.float().numpy(),
        )
        viewpoints = [view.viewpoint for view in task.views]
        heading = None
        if self._settings.heading == "any":
            heading = find_heading(made.gaussians, pictures, viewpoints)
        one = TargetCandidate(target, made.gaussians, pictures, viewpoints, heading or 0.0)
        quality = None if self._score is None else self._score(one)
        record = _record(blank.model_copy(update={"heading_deg": heading}), made, quality)
        return TargetOutcome(record, target, contact_sheet(one))

    def _generate(self, pictures: Sequence[Image], seed: int, name: str) -> GeneratedVehicle:
        settings = self._settings
        made = generate(
            self._model,
            [pictures],
            [seed],
            names=[name],
            mode=settings.mode,
            structure=settings.structure,
            latent=settings.latent,
            limits=GenerationLimits(settings.max_voxels, settings.retries),
        ).vehicles[0]
        values = (made.structure, made.latent, made.gaussians.means, made.gaussians.log_scales)
        if not all(bool(torch.isfinite(value).all()) for value in values):
            problem = "the model produces values that are not finite"
            raise InputError(name, f"seed {seed}", problem, "check the weights of the model")
        return made


def _pictures(views: Sequence[EncodedView]) -> list[Image]:
    pictures = []
    for view in views:
        try:
            pictures.append(view.picture())
        except InputError as error:
            raise InputError(
                error.where, error.field, f"{view.name}: {error.field} {error.problem}", error.mend
            ) from None
    return pictures


def _record(blank: TargetRecord, made: GeneratedVehicle, quality: Quality | None) -> TargetRecord:
    found: dict[str, object] = {
        "seed": made.seed,
        "voxels": len(made.coords),
        "gaussians": len(made.gaussians),
    }
    if quality is not None:
        found |= {
            "score": quality.score,
            "score_flipped": quality.flipped,
            "parts": dict(quality.parts),
        }
    return blank.model_copy(update=found)


def start_maker(
    number: int, source: ModelSource, settings: TargetSettings
) -> Callable[[VehicleTask], TargetOutcome]:
    """What worker `number` makes targets with; CUDA devices go round where none is named."""
    device = source.device
    if device is None and torch.cuda.is_available():
        device = f"cuda:{number % torch.cuda.device_count()}"
    return TargetMaker.load(source, settings, device).make


def absolute(source: ModelSource, settings: TargetSettings) -> tuple[ModelSource, TargetSettings]:
    """The same with paths that do not depend on the working folder, which is another on a cluster.

    The model folder must lie under the same path on every machine of it.
    """

    def path(given: Path | None) -> Path | None:
        return None if given is None else given.absolute()

    quality = settings.filter
    files = {"predictor": path(quality.predictor), "clip": path(quality.clip)}
    return (
        replace(source, folder=source.folder.absolute(), image_encoder=path(source.image_encoder)),
        settings.model_copy(update={"filter": quality.model_copy(update=files)}),
    )


def contact_sheet(candidate: TargetCandidate) -> bytes:
    """PNG of 4 x 3 tiles: the four pictures, the target from there, and 45 degrees further on.

    The columns go around the vehicle: front, left, rear, right. A target whose heading is not
    `candidate.heading_deg` shows another side under each picture, such as its tail under the front.
    """
    rows: list[list[Image]] = [[], [], []]
    for column, index in enumerate(_COLUMNS):
        view = turned(candidate.viewpoints[index], candidate.heading_deg)
        shown = resized(of_picture(candidate.pictures[index]), TILE).before(_GREY)
        rows[0].append(_captioned(shown, f"image: {_CAPTIONS[column]}"))
        # Not framed: floaters and a target of the wrong size must be seen.
        there, further = (
            render(candidate.gaussians, one, TILE).before(_GREY) for one in (view, turned(view, 45))
        )
        rows[1].append(_captioned(there, "target"))
        rows[2].append(further)
    return encode(np.vstack([np.hstack(row) for row in rows]))


def _captioned(tile: Image, text: str) -> Image:
    tile = np.ascontiguousarray(tile)
    draw_text(tile, (5, 14), text, (255, 255, 255), 12, "ls")
    return tile


def open_score(settings: FilterSettings) -> QualityScore | None:
    """The score that settings ask for, its weights read; None for no filter.

    Raises:
        InputError: weights are not named, missing or of another network.
    """
    if settings.kind == "none":
        return None
    if settings.kind == "agreement":
        return AgreementScore()
    return AestheticScore.load(*_aesthetic_files(settings))


def filter_record(settings: FilterSettings) -> FilterRecord:
    """What the cache says of the filter; the weights are checked as far as is quick.

    Raises:
        InputError: as `open_score`.
    """
    if settings.kind == "none":
        if settings.threshold is not None:
            mend = "choose a `filter`, or leave `threshold` out"
            raise InputError("`threshold`", "value", "needs a filter", mend)
        return FilterRecord()
    weights: dict[str, str] = {}
    if settings.kind == "agreement":
        name, threshold = AgreementScore.name, AgreementScore.threshold
    else:
        name, threshold = AestheticScore.name, AestheticScore.threshold
        weights = weight_hashes(*_aesthetic_files(settings))
    if settings.threshold is not None:
        threshold = settings.threshold
    return FilterRecord(score=name, threshold=threshold, weights=weights)


def _aesthetic_files(settings: FilterSettings) -> tuple[Path, Path]:
    if settings.predictor is None or settings.clip is None:
        missing = "`predictor`" if settings.predictor is None else "`clip`"
        mend = (
            "give the predictor's .pth file and a folder of CLIP ViT-L/14, or for small models "
            "use `filter` agreement"
        )
        raise InputError(missing, "weights", "are not given", mend)
    return settings.predictor, settings.clip
