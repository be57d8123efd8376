"""Settings of a scene training run: the methods it is trained by and their numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, NonNegativeFloat, NonNegativeInt, PositiveFloat

from recast.core.files import read_json, write_json
from recast.core.records import Record, parse_record
from recast.scene.densify import Measure

CONFIG_VERSION = 1
MOST_LAYERS, MOST_WIDTH, MOST_BANDS, MOST_CODE = 16, 1024, 16, 256
"""Limits of the deformation network."""
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class SceneConfig(Record):
    """Settings of `train_scene`. Schedules run over iterations, never over the clock.

    The first fields choose between the methods in which published trainers differ; the defaults are
    recast's own, and `recast.scene.presets` has the values of Street Gaussians and of OmniRe. The
    learning rates are those of the start; `schedule.py` decays them over the run.
    """

    model_config = ConfigDict(use_attribute_docstrings=True)

    sky: Literal["panorama", "cubemap"] = "panorama"
    """Cells of the sky in training: 'panorama' or 'cubemap'."""
    sky_face_px: Annotated[int, Field(ge=1, le=4096)] = 128
    """Edge of a face of the cubemap, pixels."""

    fourier_terms: Annotated[int, Field(ge=1, le=9)] = 1
    """Number of terms of an actor's colour over its time; 1: constant."""
    appearance_share: Share = 0.5
    """Time at which a time-dependent actor's colours are frozen for simulation, as a fraction of
    its track (0 to 1)."""
    deformable: bool = False
    """Whether pedestrians and cyclists deform over time; otherwise they are rigid."""
    deformation_layers: Annotated[int, Field(ge=1, le=MOST_LAYERS)] = 8
    """Number of hidden layers of the deformation network."""
    deformation_width: Annotated[int, Field(ge=1, le=MOST_WIDTH)] = 256
    """Width of these layers."""
    deformation_bands: Annotated[int, Field(ge=0, le=MOST_BANDS)] = 10
    """Number of octaves of a Gaussian's encoded place."""
    deformation_time_bands: Annotated[int, Field(ge=0, le=MOST_BANDS)] = 10
    """Number of octaves of the encoded time."""
    deformation_code: Annotated[int, Field(ge=1, le=MOST_CODE)] = 16
    """Length of the code of each deformable actor."""
    deformation_lr: NonNegativeFloat = 8e-4
    """Learning rate of the deformation network and the codes."""
    deformation_from: Share = 0.1
    """Share of the steps after which actors deform."""

    smpl_model: str = ""
    """File of the body model of SMPL nodes."""
    smpl_poses: str = ""
    """File of the poses of SMPL nodes."""

    flip_probability: Share = 0.0
    """Probability that a step sees an actor's Gaussians mirrored; 0: off."""
    exposure_lr: NonNegativeFloat = 0.0
    """Learning rate of each image's affine colours; 0: off."""
    exposure_weight: NonNegativeFloat = 0.0
    """Weight of the mean absolute change of an image's colours."""

    depth_error: Literal["relative", "metric", "inverse"] = "relative"
    """Error of a depth: 'relative', 'metric' (metres) or 'inverse' (of 1 / metres)."""
    depth_keep: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Share of the smallest depth errors that count."""
    sky_mask: Literal["heuristic", "files", "model"] = "heuristic"
    """Source of the sky masks: 'heuristic', 'files' or 'model'."""
    sky_mask_path: str = ""
    """Folder of FRAME_CAMERA.png, white where the sky is, or of a SegFormer."""
    sky_loss: Literal["opacity", "entropy"] = "opacity"
    """'opacity' at sky pixels; 'entropy': also pushes the other pixels towards full opacity."""
    densify_by: Measure = "signed"
    """Screen-space gradient: 'signed', 'absolute_norm' or 'absolute_l1'."""
    actor_densify_by: Measure = "signed"
    """The same for actors."""
    sharp_shape_weight: NonNegativeFloat = 0.0
    """Weight of the loss on axes longer than ten times the shortest, every tenth step."""
    track_smoothness_weight: NonNegativeFloat = 0.0
    """Weight of the loss on uneven motion of the tracks."""
    actor_opacity_weight: NonNegativeFloat = 0.0
    """Weight of the loss on half-opaque actors, after densification."""

    version: int = CONFIG_VERSION
    cameras: tuple[str, ...] = ()
    """Names of the cameras to train on; all if none is named."""
    scale: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Image scale: 0.5 makes 1242x375 621x188."""
    iterations: Count = 2800
    """Number of training steps, one view each."""
    seed: int = 0
    """Seed of everything random."""
    holdout_every: NonNegativeInt = 8
    """Every n-th frame is held out; 0: none."""
    holdout_offset: NonNegativeInt = 3
    """Index of the first held-out frame."""
    force_dynamic: tuple[str, ...] = ()
    """Tracks to model as actors in any case."""
    exclude_tracks: tuple[str, ...] = ()
    """Tracks to leave out of the scene."""

    coarse_fraction: Share = 0.15
    """Share of the steps at coarser image scales."""
    coarse_factors: tuple[Count, ...] = (2,)
    """Factors of these scales, one after the other."""
    voxel_m: PositiveFloat = 0.22
    """Voxel of LiDAR points of the background, metres."""
    actor_voxel_m: PositiveFloat = 0.05
    """Voxel of LiDAR points of actors, metres."""
    sweep_points: NonNegativeInt = 50_000
    """Maximum number of points from the plane sweep; 0: none."""
    sh_degree: Annotated[int, Field(ge=0, le=3)] = 1
    """Degree of the view-dependent colour."""
    max_gaussians: Count | None = None
    """Maximum number of Gaussians; none: from the area of the street and the images."""

    means_lr: float = 1.2e-2
    """Step size of centres, metres."""
    quats_lr: float = 6e-3
    """Learning rate of quaternions, constant."""
    scales_lr: float = 3e-2
    """Learning rate of log scales."""
    opacities_lr: float = 0.18
    """Learning rate of opacity logits."""
    colours_lr: float = 1.5e-2
    """Learning rate of the constant harmonic; the others get a twentieth."""
    sky_lr: float = 1e-2
    """Learning rate of the sky map."""
    camera_pose_lr: NonNegativeFloat = 1e-3
    """Step size of camera positions, metres; rotations get a tenth, in radians; 0: fixed."""
    actor_pose_lr: NonNegativeFloat = 2e-3
    """Step size of the poses of moving actors, metres and radians; 0: fixed."""

    ssim_weight: Share = 0.2
    """Weight of SSIM in the image loss; the rest is L1."""
    depth_weight: NonNegativeFloat = 0.1
    """Weight of the LiDAR depth loss."""
    sky_weight: NonNegativeFloat = 0.02
    """Weight of the loss that removes opacity in front of the sky."""
    solid_weight: NonNegativeFloat = 0.02
    """Weight of the loss that pushes accumulated opacity towards 1 at LiDAR returns."""
    ground_tolerance_m: NonNegativeFloat = 0.02
    """Maximum distance of centres on even ground from its surface, metres; 0: free."""

    densify_every: Count = 100
    """Steps between two densifications."""
    densify_until: Share = 0.6
    """Share of the steps after which it ends."""
    densify_growth: NonNegativeFloat = 0.08
    """Maximum share of new Gaussians in one densification."""
    densify_from: Share = 0.0
    """Share of the steps after which densification starts."""
    densify_gradient: PositiveFloat = 3e-4
    """Threshold of the mean image-plane gradient, NDC units."""
    actor_densify_gradient: PositiveFloat | None = None
    """The same for actors; null: the same value."""
    split_above_m: PositiveFloat = 0.08
    """Size above which Gaussians are split, and below which they are cloned, metres."""
    actor_split_above_m: PositiveFloat = 0.03
    """The same for actors."""
    prune_opacity: Annotated[float, Field(ge=0, lt=1)] = 0.01
    """Gaussians of less opacity are removed."""
    prune_above_m: PositiveFloat = 1e6
    """Larger Gaussians are removed, from the first opacity reset on, metres."""
    actor_prune_above_m: PositiveFloat = 1e6
    """The same for actors."""
    opacity_reset_every: Share = 0.0
    """Share of the steps between two opacity resets to 0.01; 0: none."""
    opacity_reset_until: Share = 1.0
    """Share of the steps after which there are no more resets."""
    densify_pause: Share = 0.0
    """Maximum share of the reset interval during which densification pauses after an opacity reset;
    0: none."""

    evaluate_every: Count = 500
    """Steps between two evaluations of held-out PSNR."""
    checkpoint_every: Count = 200
    """Steps between two checkpoints."""
    threads: Annotated[int, Field(ge=0, le=1024)] = 0
    """Number of CPU threads; 0: all."""

    def is_whole(self) -> bool:
        """Whether every field was named, as in the record of a run."""
        return self.model_fields_set >= SceneConfig.model_fields.keys()


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
