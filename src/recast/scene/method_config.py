"""Which method a scene is trained by: the choices in which published trainers differ."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from recast.core.records import Record
from recast.scene.deformation import MOST_BANDS, MOST_CODE, MOST_LAYERS, MOST_WIDTH
from recast.scene.densify import Measure


class MethodConfig(Record):
    """Fields of `SceneConfig` that choose between methods; the defaults are recast's own.

    `recast.scene.presets` has the values of Street Gaussians and of OmniRe.
    """

    sky: Literal["panorama", "cubemap"] = Field(
        default="panorama", description="cells of the sky in training: 'panorama' or 'cubemap'"
    )
    sky_face_px: int = Field(
        default=128, ge=1, le=4096, description="edge of a face of the cubemap, pixels"
    )

    fourier_terms: int = Field(
        default=1,
        ge=1,
        le=9,
        description="number of terms of an actor's colour over its time; 1: constant",
    )
    appearance_share: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description=(
            "time at which a time-dependent actor's colours are frozen for "
            "simulation, as a fraction of its track (0 to 1)"
        ),
    )
    deformable: bool = Field(
        default=False,
        description=("whether pedestrians and cyclists deform over time; otherwise they are rigid"),
    )
    deformation_layers: int = Field(
        default=8,
        ge=1,
        le=MOST_LAYERS,
        description="number of hidden layers of the deformation network",
    )
    deformation_width: int = Field(
        default=256, ge=1, le=MOST_WIDTH, description="width of these layers"
    )
    deformation_bands: int = Field(
        default=10,
        ge=0,
        le=MOST_BANDS,
        description="number of octaves of a Gaussian's encoded place",
    )
    deformation_time_bands: int = Field(
        default=10, ge=0, le=MOST_BANDS, description="number of octaves of the encoded time"
    )
    deformation_code: int = Field(
        default=16, ge=1, le=MOST_CODE, description="length of the code of each deformable actor"
    )
    deformation_lr: float = Field(
        default=8e-4, ge=0, description="learning rate of the deformation network and the codes"
    )
    deformation_from: float = Field(
        default=0.1, ge=0, le=1, description="share of the steps after which actors deform"
    )

    smpl_model: str = Field(default="", description="file of the body model of SMPL nodes")
    smpl_poses: str = Field(default="", description="file of the poses of SMPL nodes")

    flip_probability: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="probability that a step sees an actor's Gaussians mirrored; 0: off",
    )
    exposure_lr: float = Field(
        default=0.0, ge=0, description="learning rate of each image's affine colours; 0: off"
    )
    exposure_weight: float = Field(
        default=0.0, ge=0, description="weight of the mean absolute change of an image's colours"
    )

    depth_error: Literal["relative", "metric", "inverse"] = Field(
        default="relative",
        description=(
            "error of a depth: 'relative', 'metric' (metres) or 'inverse' (of 1 / metres)"
        ),
    )
    depth_keep: float = Field(
        default=0.95, gt=0, le=1, description="share of the smallest depth errors that count"
    )
    sky_mask: Literal["heuristic", "files", "model"] = Field(
        default="heuristic", description="source of the sky masks: 'heuristic', 'files' or 'model'"
    )
    sky_mask_path: str = Field(
        default="",
        description="folder of FRAME_CAMERA.png, white where the sky is, or of a SegFormer",
    )
    sky_loss: Literal["opacity", "entropy"] = Field(
        default="opacity",
        description=(
            "'opacity' at sky pixels; 'entropy': also pushes the other pixels towards full opacity"
        ),
    )
    densify_by: Measure = Field(
        default="signed",
        description="screen-space gradient: 'signed', 'absolute_norm' or 'absolute_l1'",
    )
    actor_densify_by: Measure = Field(default="signed", description="the same for actors")
    sharp_shape_weight: float = Field(
        default=0.0,
        ge=0,
        description=(
            "weight of the loss on axes longer than ten times the shortest, every tenth step"
        ),
    )
    track_smoothness_weight: float = Field(
        default=0.0, ge=0, description="weight of the loss on uneven motion of the tracks"
    )
    actor_opacity_weight: float = Field(
        default=0.0,
        ge=0,
        description="weight of the loss on half-opaque actors, after densification",
    )
