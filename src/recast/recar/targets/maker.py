"""One target from one vehicle: what a process of the builder does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from recast.errors import InputError
from recast.recar.picture import Image
from recast.recar.record import Split
from recast.recar.targets.heading import find_heading
from recast.recar.targets.model_source import ModelSource
from recast.recar.targets.preview import contact_sheet
from recast.recar.targets.quality import Candidate, Quality, QualityScore, open_score
from recast.recar.targets.record import TargetRecord
from recast.recar.targets.settings import TargetSettings, identity_seed
from recast.recar.targets.target import Target
from recast.recar.targets.views import EncodedView
from recast.trellis import GeneratedVehicle, GenerationLimits, ImageTo3D, generate


@dataclass(frozen=True)
class Job:
    """A vehicle to make a target of.

    Attributes:
        id, split, kind, colour: see `TargetRecord`.
        views: front, rear, left, right; fewer where one could not be read.
        failure: why there is nothing to do.
    """

    id: str
    split: Split
    kind: str
    colour: str | None
    views: tuple[EncodedView, ...]
    failure: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of a job; `target` and `preview` are None where it failed."""

    record: TargetRecord
    target: Target | None = None
    preview: bytes | None = field(default=None, repr=False)


class TargetMaker:
    """Makes targets with a model and a score of its own.

    Args:
        model: ready to run.
        settings: how.
        score: of the quality filter, if there is one.
    """

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

    def make(self, job: Job) -> Outcome:
        """The target of a vehicle, judged, with its contact sheet; or why there is none."""
        seed = identity_seed(self._settings.seed, job.id)
        blank = TargetRecord(
            id=job.id, split=job.split, kind=job.kind, colour=job.colour, seed=seed
        )
        if job.failure is not None:
            return Outcome(blank.model_copy(update={"failure": job.failure}))
        try:
            pictures = _pictures(job.views)
            made = self._generate(pictures, seed, job.id)
        except InputError as error:
            return Outcome(blank.model_copy(update={"failure": error.problem}))
        target = Target(
            made.structure.float().numpy(), made.coords.numpy().astype(np.int32),
            made.latent.float().numpy(),
        )  # fmt: skip
        viewpoints = [view.viewpoint for view in job.views]
        heading = None
        if self._settings.heading == "any":
            heading = find_heading(made.gaussians, pictures, viewpoints)
        one = Candidate(target, made.gaussians, pictures, viewpoints, heading or 0.0)
        quality = None if self._score is None else self._score(one)
        record = _record(blank.model_copy(update={"heading_deg": heading}), made, quality)
        return Outcome(record, target, contact_sheet(one))

    def _generate(self, pictures: Sequence[Image], seed: int, name: str) -> GeneratedVehicle:
        settings = self._settings
        made = generate(
            self._model, [pictures], [seed], names=[name], mode=settings.mode,
            structure=settings.structure, latent=settings.latent,
            limits=GenerationLimits(settings.max_voxels, settings.retries),
        ).vehicles[0]  # fmt: skip
        values = (made.structure, made.latent, made.gaussians.means, made.gaussians.log_scales)
        if not all(bool(torch.isfinite(value).all()) for value in values):
            raise InputError(name, f"seed {seed}", "the model gives values that are not finite",
                             "check the model")  # fmt: skip
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
        "seed": made.seed, "voxels": len(made.coords), "gaussians": len(made.gaussians),
    }  # fmt: skip
    if quality is not None:
        found |= {"score": quality.score, "score_flipped": quality.flipped,
                  "parts": dict(quality.parts)}  # fmt: skip
    return blank.model_copy(update=found)
