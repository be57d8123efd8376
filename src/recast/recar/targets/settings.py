"""How targets are made."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

from pydantic import Field, FiniteFloat

from recast.records import Record
from recast.trellis import MultiImageMode, SamplerSettings

FilterKind = Literal["agreement", "aesthetic", "none"]
Heading = Literal["any", "+x"]


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
        seed: from which the seed of every vehicle is derived.
        mode: of the multi-image pipeline.
        structure, latent: samplers; None takes those of the checkpoint.
        retries: further seeds for a structure that is empty or too large.
        max_voxels: more of them are too many; None takes 8 R^2, the published limit.
        heading: where vehicles of the model look: along +x, as those of models that were trained so
            do, and a target that does not is one that failed; or any way, as those of the published
            ones, which is then found by the pictures.
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
