"""Settings of a scene training run: methods, numbers, and the presets of published trainers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    ValidationError,
)

from recast.core.errors import InputError
from recast.core.files import read_json, write_json
from recast.core.records import Record, parse_record, validation_error
from recast.scene.deformation import MOST_BANDS, MOST_CODE, MOST_LAYERS, MOST_WIDTH
from recast.splats import CLASSIC, MIP, LowPass

CONFIG_VERSION = 1
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Measure = Literal["signed", "absolute_norm", "absolute_l1"]
"""What is counted of a row's screen-space gradient in a view: the length of its sum over pixels
(3DGS); or, with the components' sizes added up over pixels (AbsGS), their length (gsplat) or sum
(Street Gaussians).
"""
Preset = Literal["streetgs", "omnire"]
PUBLISHED_STEPS = 30_000
EXPONENT = 0.75
"""Rates grow with this power of how many times fewer the steps are: what trials on a CPU came to
(six times the published rates at 2900 steps, twelve times at 1000)."""
MOST = 12.0
"""Times the published rate: more has not been tried."""
MOST_METRES = 0.02
"""Metres of a centre in one step, at most: more has not been tried."""
MOST_DEFORMATION_RATE = 3e-3
"""Learning rate of the deformation network, at most: 1e-2 was no better in trials on a CPU."""
RESET_EVERY = 0.1
"""Share of the run between resets of opacities."""
LEAST_BETWEEN_RESETS = 300
"""Steps: every view must be seen a few times before what was lowered is judged."""
_RATES_OF_BOTH = {
    "quats_lr": 1e-3,
    "scales_lr": 5e-3,
    "opacities_lr": 0.05,
    "colours_lr": 2.5e-3,
    "sky_lr": 0.01,
    "actor_pose_lr": 5e-4,
}
_RATES: dict[Preset, dict[str, float]] = {
    # Centres: 1.6e-4 times the scene's radius, which is 10 m (Street Gaussians' `extent`) and, of
    # the LiDAR's bounds in OmniRe, about 50 m.
    "streetgs": {**_RATES_OF_BOTH, "means_lr": 1.6e-3, "camera_pose_lr": 0.0, "exposure_lr": 0.0},
    "omnire": {
        **_RATES_OF_BOTH,
        "means_lr": 8e-3,
        "camera_pose_lr": 1e-4,
        "exposure_lr": 5e-4,
        "deformation_lr": 8e-4,
    },
}
_OF_BOTH: dict[str, Any] = {
    "low_pass": CLASSIC,
    "unseen_surfaces": False,
    "sky": "cubemap",
    "sky_loss": "entropy",
    "sky_weight": 0.05,
    "depth_error": "metric",
    # Opacity is the entropy's, and roads are like the rest of the scene.
    "solid_weight": 0.0,
    "ground_tolerance_m": 0.0,
    # Adaptive density control of 3DGS: every row above the threshold.
    "densify_growth": 1e3,
    "densify_from": 1 / 60,
    "prune_opacity": 0.005,
}
_VALUES: dict[Preset, dict[str, Any]] = {
    "streetgs": {
        **_OF_BOTH,
        "sh_degree": 1,
        "fourier_terms": 5,
        "flip_probability": 0.2,
        "coarse_fraction": 0.0,
        "depth_keep": 0.95,
        "depth_weight": 0.1,
        "actor_opacity_weight": 0.1,
        "densify_until": 25 / 30,
        "opacity_reset_until": 25 / 30,
        "densify_by": "absolute_l1",
        "densify_gradient": 6e-4,
        "actor_densify_by": "signed",
        "actor_densify_gradient": 2e-4,
        "split_above_m": 0.1,
        "prune_above_m": 1.0,
        # Of a car of 4.5 m: 0.01 and 0.1 times max(1.5 l, 1.5 w, h) / 2.
        "actor_split_above_m": 0.034,
        "actor_prune_above_m": 0.34,
    },
    "omnire": {
        **_OF_BOTH,
        "sh_degree": 3,
        "deformable": True,
        "coarse_fraction": 1 / 60,
        "coarse_factors": (4, 2),
        "depth_keep": 1.0,
        "depth_weight": 0.01,
        "sharp_shape_weight": 1.0,
        "track_smoothness_weight": 0.01,
        "exposure_s": 0.0,
        "exposure_weight": 1e-5,
        "densify_until": 0.5,
        # As at the published steps, a tenth of the run is left after the last one.
        "opacity_reset_until": 1 - RESET_EVERY,
        # A step an image, at least 100; a third of the time between resets holds 1000 images at the
        # published steps, and leaves short runs two changes of three.
        "densify_pause": 1 / 3,
        "densify_by": "absolute_norm",
        "densify_gradient": 5e-4,
        "actor_densify_by": "absolute_norm",
        "actor_densify_gradient": 5e-4,
        "split_above_m": 0.15,
        "actor_split_above_m": 0.15,
        "prune_above_m": 25.0,
        "actor_prune_above_m": 5.0,
    },
}


class SceneConfig(Record):
    """Settings of `train_scene`. Schedules run over iterations, never over the clock.

    The first fields choose between the methods in which published trainers differ; the defaults are
    recast's own, and `preset_values` has the values of Street Gaussians and of OmniRe. The
    learning rates are those of the start; `schedule.py` decays them over the run.
    """

    model_config = ConfigDict(use_attribute_docstrings=True)

    low_pass: LowPass = MIP
    """Filter through which the street is trained and drawn: `variance`, px^2 added to projected
    covariances, and `antialiased`, whether opacity is lowered by as much."""

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
    exposure_lr: NonNegativeFloat = 0.03
    """Learning rate of the affine change of an image's colours; 0: off."""
    exposure_s: NonNegativeFloat = 0.5
    """Seconds between the times at which a camera's change is learned; 0: at each image."""
    exposure_weight: NonNegativeFloat = 1e-3
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
    unseen_surfaces: bool = True
    """Whether the street begins with surfaces that the LiDAR met and no image shows, too."""
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


def preset_values(name: Preset, iterations: int) -> dict[str, Any]:
    """The configuration fields that a preset sets, for a number of steps."""
    factor = min((PUBLISHED_STEPS / iterations) ** EXPONENT, MOST)
    rates = {field: factor * rate for field, rate in _RATES[name].items()}
    rates["means_lr"] = min(rates["means_lr"], MOST_METRES)
    if "deformation_lr" in rates:
        rates["deformation_lr"] = min(rates["deformation_lr"], MOST_DEFORMATION_RATE)
    resets = min(max(RESET_EVERY, LEAST_BETWEEN_RESETS / iterations), 1.0)
    return {**_VALUES[name], **rates, "opacity_reset_every": resets, "iterations": iterations}


def resolve_config(
    preset: Preset | None = None,
    written: SceneConfig | None = None,
    options: Mapping[str, Any] | None = None,
) -> SceneConfig:
    """One configuration of a preset, what a file sets over it, and options over both.

    Args:
        preset: None for recast's own recipe.
        written: a configuration as `read_config` gives it; only fields that its file names count.
        options: fields by name; those that are None were not given.

    Raises:
        InputError: an option is out of range, or the file leaves nothing for the preset to set.
    """
    if preset is not None and written is not None and written.is_whole():
        raise InputError(
            "`preset`",
            preset,
            "changes nothing: the configuration file names every field",
            "leave out the preset or the file",
        )
    named = {} if written is None else written.model_dump(include=written.model_fields_set)
    named |= {field: value for field, value in (options or {}).items() if value is not None}
    try:
        asked = SceneConfig.model_validate(named)
        base = {} if preset is None else preset_values(preset, asked.iterations)
        return SceneConfig.model_validate(base | named)
    except ValidationError as error:
        raise validation_error(
            "options", error, "give a value in range", SceneConfig.model_fields
        ) from None
