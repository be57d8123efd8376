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
