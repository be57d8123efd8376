"""What a scene training run can be told, and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from recast.records import parse_record
from recast.scene.method_config import MethodConfig
from recast.storage import read_json, write_json

CONFIG_VERSION = 1
_YOUNGEST = (
    "densify_by", "actor_densify_by", "actor_densify_gradient", "densify_pause",
    "deformable", "deformation_layers", "deformation_width", "deformation_bands",
    "deformation_time_bands", "deformation_code", "deformation_lr", "deformation_from",
    "smpl_model", "smpl_poses",
)  # fmt: skip


class SceneConfig(MethodConfig):
    """Settings of `train_scene`. Schedules run over iterations, never over the clock.

    The learning rates are those of the start; `train.py` decays them over the run.
    """

    version: int = CONFIG_VERSION
    cameras: tuple[str, ...] = Field(default=(), description="cameras to train on; none named: all")
    scale: float = Field(
        default=0.5, gt=0, le=1, description="image scale: 0.5 makes 1242x375 621x188"
    )
    iterations: int = Field(default=2800, ge=1, description="training steps, one view each")
    seed: int = Field(default=0, description="of everything random")
    holdout_every: int = Field(
        default=8, ge=0, description="frames kept from training: every n-th, 0: none"
    )
    holdout_offset: int = Field(default=3, ge=0, description="first frame kept")
    force_dynamic: tuple[str, ...] = Field(
        default=(), description="tracks to model though they hardly move"
    )
    exclude_tracks: tuple[str, ...] = Field(
        default=(), description="tracks to leave out of the scene"
    )

    coarse_fraction: float = Field(
        default=0.15, ge=0, le=1, description="share of the run at a coarser scale"
    )
    coarse_factors: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(2,), description="by which it is coarser, one after the other"
    )
    voxel_m: float = Field(default=0.22, gt=0, description="LiDAR voxel of the background")
    actor_voxel_m: float = Field(default=0.05, gt=0, description="LiDAR voxel of the actors")
    sweep_points: int = Field(
        default=50_000, ge=0, description="most points from the plane sweep, 0: none"
    )
    sh_degree: int = Field(default=1, ge=0, le=3, description="of view-dependent colour")
    max_gaussians: int | None = Field(
        default=None, ge=1, description="most Gaussians; none: by the street's area and the images"
    )

    means_lr: float = Field(default=1.2e-2, description="of centres, metres a step")
    quats_lr: float = Field(default=6e-3, description="of quaternions, constant")
    scales_lr: float = Field(default=3e-2, description="of log scales")
    opacities_lr: float = Field(default=0.18, description="of logits")
    colours_lr: float = Field(
        default=1.5e-2, description="of the constant harmonic; the others get a twentieth"
    )
    sky_lr: float = Field(default=1e-2, description="of the sky map")
    camera_pose_lr: float = Field(
        default=1e-3, ge=0, description="metres; radians get a tenth; 0: fixed"
    )
    actor_pose_lr: float = Field(default=2e-3, ge=0, description="metres and radians; 0: fixed")

    ssim_weight: float = Field(default=0.2, ge=0, le=1, description="the rest is L1")
    depth_weight: float = Field(default=0.1, ge=0, description="of LiDAR depth")
    sky_weight: float = Field(default=0.02, ge=0, description="of opacity before the sky")
    solid_weight: float = Field(
        default=0.02, ge=0, description="of what opacity lacks where the LiDAR met something"
    )
    ground_tolerance_m: float = Field(
        default=0.02, ge=0, description="of centres on even ground about its surface, 0: free"
    )

    densify_every: int = Field(default=100, ge=1, description="steps")
    densify_until: float = Field(default=0.6, ge=0, le=1, description="share of the run")
    densify_growth: float = Field(
        default=0.08, ge=0, description="most new rows a time, share of all"
    )
    densify_from: float = Field(
        default=0.0, ge=0, le=1, description="share of the run after which it starts"
    )
    densify_gradient: float = Field(
        default=3e-4, gt=0, description="mean image-plane gradient, NDC units"
    )
    actor_densify_gradient: float | None = Field(
        default=None, gt=0, description="likewise of actors; none: the same"
    )
    split_above_m: float = Field(
        default=0.08, gt=0, description="larger Gaussians are split, smaller ones cloned"
    )
    actor_split_above_m: float = Field(default=0.03, gt=0, description="likewise of actors")
    prune_opacity: float = Field(default=0.01, ge=0, lt=1, description="fainter ones go")
    prune_above_m: float = Field(
        default=1e6, gt=0, description="larger ones go, from the first reset of opacities on"
    )
    actor_prune_above_m: float = Field(default=1e6, gt=0, description="likewise of actors")
    opacity_reset_every: float = Field(
        default=0.0, ge=0, le=1, description="share of the run between resets to 0.01, 0: none"
    )
    opacity_reset_until: float = Field(default=1.0, ge=0, le=1, description="share of the run")
    densify_pause: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="most of the time between resets that changes wait after one, 0: none",
    )

    evaluate_every: int = Field(default=500, ge=1, description="steps between held-out PSNRs")
    checkpoint_every: int = Field(default=200, ge=1, description="steps that a kill costs at most")
    threads: int = Field(default=0, ge=0, le=1024, description="CPU threads, 0: all")

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
