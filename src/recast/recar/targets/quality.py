"""The seam of the quality filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from recast.errors import InputError
from recast.recar.picture import Image
from recast.recar.targets.record import FilterRecord
from recast.recar.targets.settings import FilterSettings
from recast.recar.targets.target import Target
from recast.recar.targets.views import Viewpoint
from recast.splats import Gaussians


@dataclass(frozen=True)
class Candidate:
    """A target to judge.

    Attributes:
        target: its latents and voxels.
        gaussians: decoded, in the unit cube.
        pictures: front, rear, left, right that it was made from; RGBA with straight alpha.
        viewpoints: where they were taken from, azimuth 0 ahead of the vehicle.
        heading_deg: direction of the vehicle's front in the frame of the target, 0 along +x.
    """

    target: Target
    gaussians: Gaussians
    pictures: Sequence[Image]
    viewpoints: Sequence[Viewpoint]
    heading_deg: float = 0.0


@dataclass(frozen=True)
class Quality:
    """What a score says; more is better.

    Attributes:
        score: of the target.
        flipped: score with front and rear exchanged; None where the score cannot tell.
        parts: what the score is made of, by name.
    """

    score: float
    flipped: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


class QualityScore(Protocol):
    """A way to judge targets.

    Attributes:
        name: under which scores are recorded.
        threshold: least score of a target that is used, where the user names none.
    """

    name: str
    threshold: float

    def __call__(self, candidate: Candidate) -> Quality:
        """Judge a target; the same target gets the same score."""
        ...


def open_score(settings: FilterSettings) -> QualityScore | None:
    """The score that settings ask for, its weights read; None for no filter.

    Raises:
        InputError: weights are not named, missing or of another network.
    """
    if settings.kind == "none":
        return None
    if settings.kind == "agreement":
        from recast.recar.targets.agreement import AgreementScore

        return AgreementScore()
    from recast.recar.targets.aesthetic import AestheticScore

    return AestheticScore.load(*_aesthetic_files(settings))


def filter_record(settings: FilterSettings) -> FilterRecord:
    """What the cache says of the filter; the weights are checked as far as is quick.

    Raises:
        InputError: as `open_score`.
    """
    if settings.kind == "none":
        if settings.threshold is not None:
            raise InputError("--threshold", "value", "needs a filter", "choose one, or leave it")
        return FilterRecord()
    weights: dict[str, str] = {}
    if settings.kind == "agreement":
        from recast.recar.targets.agreement import AgreementScore

        name, threshold = AgreementScore.name, AgreementScore.threshold
    else:
        from recast.recar.targets.aesthetic import AestheticScore, weight_hashes

        name, threshold = AestheticScore.name, AestheticScore.threshold
        weights = weight_hashes(*_aesthetic_files(settings))
    if settings.threshold is not None:
        threshold = settings.threshold
    return FilterRecord(score=name, threshold=threshold, weights=weights)


def _aesthetic_files(settings: FilterSettings) -> tuple[Path, Path]:
    if settings.predictor is None or settings.clip is None:
        missing = "--predictor" if settings.predictor is None else "--clip"
        raise InputError(
            missing, "weights", "are not named",
            "the aesthetic filter needs the predictor's .pth file and a folder of CLIP ViT-L/14; "
            "small models use --filter agreement",
        )  # fmt: skip
    return settings.predictor, settings.clip
