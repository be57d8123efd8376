"""Named sets of configuration values: the two backbones of the paper.

One trainer serves both; what differs is which of its methods are on and how strongly. Values are
those of the published code for 30 000 steps. Shares of the run hold for any number of steps, rates
are raised for fewer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import ValidationError

from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.scene.config import SceneConfig

Preset = Literal["streetgs", "omnire"]

PUBLISHED_STEPS = 30_000
EXPONENT = 0.75
"""Rates grow with this power of how many times fewer the steps are: what trials on a CPU came to
(six times the published rates at 2900 steps, twelve times at 1000)."""
MOST = 12.0
"""Times the published rate: more has not been tried."""
MOST_METRES = 0.02
"""Of a centre in one step: more has not been tried."""
MOST_DEFORMATION_RATE = 3e-3
"""Of the deformation network: 1e-2 was no better in trials on a CPU."""
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
    "streetgs": {**_RATES_OF_BOTH, "means_lr": 1.6e-3, "camera_pose_lr": 0.0},
    "omnire": {
        **_RATES_OF_BOTH,
        "means_lr": 8e-3,
        "camera_pose_lr": 1e-4,
        "exposure_lr": 5e-4,
        "deformation_lr": 8e-4,
    },
}

_OF_BOTH: dict[str, Any] = {
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
