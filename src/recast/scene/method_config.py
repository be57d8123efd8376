"""Which method a scene is trained by: the choices in which published trainers differ."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from recast.records import Record
from recast.scene.deformation import MOST_BANDS, MOST_CODE, MOST_LAYERS, MOST_WIDTH
from recast.scene.densify import Measure


class MethodConfig(Record):
    """Fields of `SceneConfig` that choose between methods; the defaults are recast's own.

    `recast.scene.presets` has the values of Street Gaussians and of OmniRe.
    """

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
    deformable: bool = Field(
        default=False, description="whether people and cyclists deform over time, else rigid"
    )
    deformation_layers: int = Field(
        default=8, ge=1, le=MOST_LAYERS, description="hidden layers of the deformation network"
    )
    deformation_width: int = Field(
        default=256, ge=1, le=MOST_WIDTH, description="width of these layers"
    )
    deformation_bands: int = Field(
        default=10, ge=0, le=MOST_BANDS, description="octaves of a Gaussian's encoded place"
    )
    deformation_time_bands: int = Field(
        default=10, ge=0, le=MOST_BANDS, description="octaves of the encoded time"
    )
    deformation_code: int = Field(
        default=16, ge=1, le=MOST_CODE, description="length of each deformable actor's code"
    )
    deformation_lr: float = Field(
        default=8e-4, ge=0, description="of the deformation network and the codes"
    )
    deformation_from: float = Field(
        default=0.1, ge=0, le=1, description="share of the run after which actors deform"
    )

    smpl_model: str = Field(
        default="", description="body model of SMPL nodes, an .npz file of the user's"
    )
    smpl_poses: str = Field(default="", description="poses of SMPL nodes, an .npz file")

    flip_probability: float = Field(
        default=0.0, ge=0, le=1, description="that a step sees an actor's Gaussian mirrored, 0: off"
    )
    exposure_lr: float = Field(
        default=0.0, ge=0, description="of each image's affine colours, 0: off"
    )
    exposure_weight: float = Field(
        default=0.0, ge=0, description="of an image's change of colours, mean absolute"
    )

    depth_error: Literal["relative", "metric", "inverse"] = Field(
        default="relative", description="of LiDAR depth: relative, in metres, or of 1 / metres"
    )
    depth_keep: float = Field(
        default=0.95, gt=0, le=1, description="share of the smallest depth errors that count"
    )
    sky_mask: Literal["heuristic", "files", "model"] = Field(
        default="heuristic", description="which pixels are sky: guessed, read, or segmented"
    )
    sky_mask_path: str = Field(
        default="", description="folder of FRAME_CAMERA.png, white the sky, or of a SegFormer"
    )
    sky_loss: Literal["opacity", "entropy"] = Field(
        default="opacity",
        description="opacity: before sky pixels; entropy: also its lack before others",
    )
    densify_by: Measure = Field(
        default="signed",
        description="screen-space gradient: of the sum over pixels, or of their sizes (AbsGS)",
    )
    actor_densify_by: Measure = Field(default="signed", description="likewise of actors")
    sharp_shape_weight: float = Field(
        default=0.0, ge=0, description="of Gaussians' axes beyond 10 to 1, every tenth step"
    )
    track_smoothness_weight: float = Field(
        default=0.0, ge=0, description="of uneven motion of the tracks"
    )
    actor_opacity_weight: float = Field(
        default=0.0, ge=0, description="of half-opaque actors, once densification is over"
    )
