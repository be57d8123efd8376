"""What a scene training run can be told, and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from recast.records import parse_record
from recast.storage import read_json, write_json

CONFIG_VERSION = 1


class SceneConfig(BaseModel):
    """Settings of `train_scene`. Schedules run over iterations, never over the clock.

    The learning rates are those of the start; `train.py` decays them over the run.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: int = CONFIG_VERSION
    cameras: tuple[str, ...] = Field(default=(), description="cameras to train on; none named: all")
    scale: float = Field(
        default=0.5, gt=0, le=1, description="image scale: 0.5 makes 1242x375 621x188"
    )
    iterations: int = Field(default=3200, ge=1)
    seed: int = 0
    holdout_every: int = Field(
        default=8, ge=0, description="frames kept from training: every n-th, 0: none"
    )
    holdout_offset: int = Field(default=3, ge=0)
    force_dynamic: tuple[str, ...] = Field(
        default=(), description="tracks to model though they hardly move"
    )
    exclude_tracks: tuple[str, ...] = Field(
        default=(), description="tracks to leave out of the scene"
    )

    coarse_fraction: float = Field(
        default=0.15, ge=0, le=1, description="share of the run at half the scale"
    )
    voxel_m: float = Field(default=0.22, gt=0, description="LiDAR voxel of the background")
    actor_voxel_m: float = Field(default=0.05, gt=0)
    sweep_points: int = Field(
        default=50_000, ge=0, description="most points from the plane sweep, 0: none"
    )
    sh_degree: int = Field(default=1, ge=0, le=3)
    max_gaussians: int = Field(default=240_000, ge=1)

    means_lr: float = Field(default=1.2e-2, description="metres")
    quats_lr: float = 6e-3
    scales_lr: float = 3e-2
    opacities_lr: float = 0.18
    colours_lr: float = 1.5e-2
    sky_lr: float = 1e-2
    camera_pose_lr: float = Field(
        default=1e-3, ge=0, description="metres; radians get a tenth; 0: fixed"
    )
    actor_pose_lr: float = Field(default=2e-3, ge=0, description="metres and radians; 0: fixed")

    ssim_weight: float = Field(default=0.2, ge=0, le=1)
    depth_weight: float = Field(default=0.05, ge=0)
    sky_weight: float = Field(default=0.02, ge=0)

    densify_every: int = Field(default=100, ge=1)
    densify_until: float = Field(default=0.6, ge=0, le=1, description="share of the run")
    densify_growth: float = Field(
        default=0.08, ge=0, description="most new rows a time, share of all"
    )
    densify_gradient: float = Field(
        default=3e-4, gt=0, description="mean image-plane gradient, NDC units"
    )

    evaluate_every: int = Field(default=500, ge=1)
    checkpoint_every: int = Field(default=200, ge=1)
    threads: int = Field(default=0, ge=0, description="CPU threads, 0: all")


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
