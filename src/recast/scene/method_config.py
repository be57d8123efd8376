"""Which method a scene is trained by: the choices in which published trainers differ."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class MethodConfig(BaseModel):
    """Fields of `SceneConfig` that choose between methods; the defaults are recast's own.

    `recast.scene.presets` has the values of Street Gaussians and of OmniRe.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sky: Literal["panorama", "cubemap"] = Field(
        default="panorama", description="cells of the sky under training; saved as a panorama"
    )
    sky_face_px: int = Field(default=128, ge=1, le=4096, description="edge of a cubemap's face")

    fourier_terms: int = Field(
        default=1, ge=1, le=9, description="of an actor's colour over its time, 1: constant"
    )
    appearance_share: float = Field(
        default=0.5, ge=0, le=1, description="of an actor's time, whose colours simulations have"
    )
    flip_probability: float = Field(
        default=0.0, ge=0, le=1, description="that a step sees an actor's Gaussian mirrored, 0: off"
    )
    exposure_lr: float = Field(
        default=0.0, ge=0, description="of each image's affine colours, 0: off"
    )
    exposure_weight: float = Field(
        default=0.0, ge=0, description="of an image's change of colours, mean absolute"
    )
