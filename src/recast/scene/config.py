"""What a scene training run can be told, and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from recast.core.files import read_json, write_json
from recast.core.records import parse_record
from recast.scene.method_config import MethodConfig

CONFIG_VERSION = 1
_YOUNGEST = (
    "densify_by",
    "actor_densify_by",
    "actor_densify_gradient",
    "densify_pause",
    "deformable",
    "deformation_layers",
    "deformation_width",
    "deformation_bands",
    "deformation_time_bands",
    "deformation_code",
    "deformation_lr",
    "deformation_from",
    "smpl_model",
    "smpl_poses",
)


class SceneConfig(MethodConfig):
    """Settings of `train_scene`. Schedules run over iterations, never over the clock.

    The learning rates are those of the start; `train.py` decays them over the run.
    """

    version: int = CONFIG_VERSION
    cameras: tuple[str, ...] = Field(
        default=(), description="names of the cameras to train on; all if none is named"
    )
    scale: float = Field(
        default=0.5, gt=0, le=1, description="image scale: 0.5 makes 1242x375 621x188"
    )
    iterations: int = Field(
        default=2800, ge=1, description="number of training steps, one view each"
    )
    seed: int = Field(default=0, description="seed of everything random")
    holdout_every: int = Field(default=8, ge=0, description="every n-th frame is held out; 0: none")
    holdout_offset: int = Field(default=3, ge=0, description="index of the first held-out frame")
    force_dynamic: tuple[str, ...] = Field(
        default=(), description="tracks to model as actors in any case"
    )
    exclude_tracks: tuple[str, ...] = Field(
        default=(), description="tracks to leave out of the scene"
    )

    coarse_fraction: float = Field(
        default=0.15, ge=0, le=1, description="share of the steps at coarser image scales"
    )
    coarse_factors: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(2,), description="factors of these scales, one after the other"
    )
    voxel_m: float = Field(
        default=0.22, gt=0, description="voxel of LiDAR points of the background, metres"
    )
    actor_voxel_m: float = Field(
        default=0.05, gt=0, description="voxel of LiDAR points of actors, metres"
    )
    sweep_points: int = Field(
        default=50_000, ge=0, description="maximum number of points from the plane sweep; 0: none"
    )
    sh_degree: int = Field(default=1, ge=0, le=3, description="degree of the view-dependent colour")
    max_gaussians: int | None = Field(
        default=None,
        ge=1,
        description=(
            "maximum number of Gaussians; none: from the area of the street and the images"
        ),
    )

    means_lr: float = Field(default=1.2e-2, description="step size of centres, metres")
    quats_lr: float = Field(default=6e-3, description="learning rate of quaternions, constant")
    scales_lr: float = Field(default=3e-2, description="learning rate of log scales")
    opacities_lr: float = Field(default=0.18, description="learning rate of opacity logits")
    colours_lr: float = Field(
        default=1.5e-2,
        description="learning rate of the constant harmonic; the others get a twentieth",
    )
    sky_lr: float = Field(default=1e-2, description="learning rate of the sky map")
    camera_pose_lr: float = Field(
        default=1e-3,
        ge=0,
        description=(
            "step size of camera positions, metres; rotations get a tenth, in radians; 0: fixed"
        ),
    )
    actor_pose_lr: float = Field(
        default=2e-3,
        ge=0,
        description="step size of the poses of moving actors, metres and radians; 0: fixed",
    )

    ssim_weight: float = Field(
        default=0.2, ge=0, le=1, description="weight of SSIM in the image loss; the rest is L1"
    )
    depth_weight: float = Field(default=0.1, ge=0, description="weight of the LiDAR depth loss")
    sky_weight: float = Field(
        default=0.02,
        ge=0,
        description="weight of the loss that removes opacity in front of the sky",
    )
    solid_weight: float = Field(
        default=0.02,
        ge=0,
        description=(
            "weight of the loss that pushes accumulated opacity towards 1 at LiDAR returns"
        ),
    )
    ground_tolerance_m: float = Field(
        default=0.02,
        ge=0,
        description=(
            "maximum distance of centres on even ground from its surface, metres; 0: free"
        ),
    )

    densify_every: int = Field(default=100, ge=1, description="steps between two densifications")
    densify_until: float = Field(
        default=0.6, ge=0, le=1, description="share of the steps after which it ends"
    )
    densify_growth: float = Field(
        default=0.08, ge=0, description="maximum share of new Gaussians in one densification"
    )
    densify_from: float = Field(
        default=0.0, ge=0, le=1, description="share of the steps after which densification starts"
    )
    densify_gradient: float = Field(
        default=3e-4, gt=0, description="threshold of the mean image-plane gradient, NDC units"
    )
    actor_densify_gradient: float | None = Field(
        default=None, gt=0, description="the same for actors; null: the same value"
    )
    split_above_m: float = Field(
        default=0.08,
        gt=0,
        description=(
            "size above which Gaussians are split, and below which they are cloned, metres"
        ),
    )
    actor_split_above_m: float = Field(default=0.03, gt=0, description="the same for actors")
    prune_opacity: float = Field(
        default=0.01, ge=0, lt=1, description="Gaussians of less opacity are removed"
    )
    prune_above_m: float = Field(
        default=1e6,
        gt=0,
        description="larger Gaussians are removed, from the first opacity reset on, metres",
    )
    actor_prune_above_m: float = Field(default=1e6, gt=0, description="the same for actors")
    opacity_reset_every: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of the steps between two opacity resets to 0.01; 0: none",
    )
    opacity_reset_until: float = Field(
        default=1.0,
        ge=0,
        le=1,
        description="share of the steps after which there are no more resets",
    )
    densify_pause: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description=(
            "maximum share of the reset interval during which densification pauses "
            "after an opacity reset; 0: none"
        ),
    )

    evaluate_every: int = Field(
        default=500, ge=1, description="steps between two evaluations of held-out PSNR"
    )
    checkpoint_every: int = Field(default=200, ge=1, description="steps between two checkpoints")
    threads: int = Field(default=0, ge=0, le=1024, description="number of CPU threads; 0: all")

    def is_whole(self) -> bool:
        """Whether every field was named, as in the record of a run; the youngest may lack."""
        return self.model_fields_set >= SceneConfig.model_fields.keys() - set(_YOUNGEST)

    def resolved(self) -> dict[str, Any]:
        """JSON-able, every default filled in but those of the youngest fields.

        What was begun before these were a choice has the same record as what leaves them alone.
        """
        values = self.model_dump(mode="json")
        for name in _YOUNGEST:
            if values[name] == SceneConfig.model_fields[name].default:
                del values[name]
        return values


def read_config(path: str | Path) -> SceneConfig:
    """Read a configuration file.

    Raises:
        InputError: missing, not JSON, of another version, or with a field that is unknown or wrong.
    """
    return parse_config(path, read_json(path))


def parse_config(where: str | Path, value: Any) -> SceneConfig:
    """Check a configuration read from `where`; raises InputError as `read_config` does."""
    mend = "correct it, train with the release that wrote it, or start from a fresh one"
    return parse_record(where, value, SceneConfig, CONFIG_VERSION, mend)


def write_config(config: SceneConfig, path: str | Path) -> None:
    """Write `config` as JSON."""
    write_json(path, config.model_dump(mode="json"))
