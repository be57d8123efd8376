"""One target from one vehicle: what a process of the builder does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from recast.arrays import Image
from recast.core.errors import InputError
from recast.logs.images import encode
from recast.recar.targets.cache import Target
from recast.recar.targets.cache_records import (
    FilterRecord,
    FilterSettings,
    ModelSource,
    TargetRecord,
    TargetSettings,
    identity_seed,
)
from recast.recar.targets.quality import (
    AestheticScore,
    AgreementScore,
    Quality,
    QualityScore,
    TargetCandidate,
    weight_hashes,
)
from recast.recar.targets.views import (
    EncodedView,
    Viewpoint,
    find_heading,
    of_picture,
    render,
    resized,
    turned,
)
from recast.recar.vehicle_set import Split
from recast.recar.views import write_words
from recast.splats import Gaussians
from recast.trellis import GeneratedVehicle, GenerationLimits, ImageTo3D, generate

TILE = 192
"""Pixels a side of a tile."""

_GREY = 0.55  # behind the vehicles, so that black ones are seen too
_COLUMNS = (0, 2, 1, 3)  # front, left, rear, right: the way around the vehicle
_CAPTIONS = ("front", "left", "rear", "right")


@dataclass(frozen=True)
class VehicleTask:
    """A vehicle to make a target of.

    Attributes:
        id, split, kind, colour: see `TargetRecord`.
        views: front, rear, left and right view; fewer where one could not be read.
        failure: reason why there is nothing to do.
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


class TargetMaker:
    """Makes targets with a model, and a score if there is a quality filter."""

    def __init__(
        self, model: ImageTo3D, settings: TargetSettings, score: QualityScore | None
    ) -> None:
        self._model = model
        self._settings = settings
        self._score = score

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
            raise InputError(
                name,
                f"seed {seed}",
                "the model produces values that are not finite",
                "check the weights of the model",
            )
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
        rows[1].append(_captioned(_tile(candidate.gaussians, view), "target"))
        rows[2].append(_tile(candidate.gaussians, turned(view, 45.0)))
    return encode(np.vstack([np.hstack(row) for row in rows]))


def _tile(gaussians: Gaussians, viewpoint: Viewpoint) -> Image:
    # Not framed: floaters and a target of the wrong size must be seen.
    return render(gaussians, viewpoint, TILE).before(_GREY)


def _captioned(tile: Image, text: str) -> Image:
    tile = np.ascontiguousarray(tile)
    write_words(tile, text, (5, 14), 0.4, (255, 255, 255))
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
            raise InputError(
                "`threshold`",
                "value",
                "needs a filter",
                "choose a `filter`, or leave `threshold` out",
            )
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
        raise InputError(
            missing,
            "weights",
            "are not given",
            "give the predictor's .pth file and a folder of CLIP ViT-L/14, or for small models "
            "use `filter` agreement",
        )
    return settings.predictor, settings.clip
