from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import pytest

from recast.core.errors import InputError
from recast.reconstruction import SceneConfig, read_config, resolve_config, write_config
from recast.reconstruction.config import MOST_DEFORMATION_RATE, Preset, preset_values

NAMES = get_args(Preset)


def test_without_a_preset_the_recipe_is_recasts_own() -> None:
    assert resolve_config() == SceneConfig()
    assert resolve_config(options={"iterations": 7, "seed": None}) == SceneConfig(iterations=7)


@pytest.mark.parametrize("name", NAMES)
def test_at_the_papers_steps_rates_are_the_published_ones(name: Preset) -> None:
    config = resolve_config(name, options={"iterations": 30_000})
    assert config.colours_lr == pytest.approx(2.5e-3)
    assert config.opacities_lr == pytest.approx(0.05)
    assert config.means_lr == pytest.approx(1.6e-4 * (10 if name == "streetgs" else 50))


@pytest.mark.parametrize("name", NAMES)
def test_fewer_steps_have_larger_rates_within_what_was_tried(name: Preset) -> None:
    short, shorter = preset_values(name, 2900), preset_values(name, 300)
    assert short["scales_lr"] == pytest.approx(5.8 * 5e-3, rel=0.01)
    assert shorter["scales_lr"] == pytest.approx(12 * 5e-3)
    assert shorter["opacity_reset_every"] == 1.0 and preset_values(name, 10)
    assert short["opacity_reset_every"] == pytest.approx(300 / 2900)
    assert short["opacity_reset_until"] <= 0.9  # what a reset takes has time to come back
    assert shorter["means_lr"] <= 0.02 and short["densify_until"] == shorter["densify_until"]


def test_the_presets_differ_where_the_methods_do() -> None:
    street, omnire = (resolve_config(name) for name in ("streetgs", "omnire"))
    differing = {
        field
        for field in SceneConfig.model_fields
        if getattr(street, field) != getattr(omnire, field)
    }
    assert differing >= {
        "fourier_terms",
        "flip_probability",
        "sh_degree",
        "depth_weight",
        "depth_keep",
        "exposure_lr",
        "camera_pose_lr",
        "sharp_shape_weight",
        "track_smoothness_weight",
        "actor_opacity_weight",
        "coarse_factors",
    }
    assert street.sky == omnire.sky == "cubemap"


def test_thresholds_belong_to_the_gradient_they_were_published_for() -> None:
    def control(config: SceneConfig) -> list[object]:
        return [
            config.densify_by,
            config.densify_gradient,
            config.actor_densify_by,
            config.actor_densify_gradient,
        ]

    assert resolve_config("streetgs").densify_pause == SceneConfig().densify_pause == 0
    assert resolve_config("omnire").densify_pause > 0
    assert control(resolve_config("streetgs")) == ["absolute_l1", 6e-4, "signed", 2e-4]
    assert control(resolve_config("omnire")) == ["absolute_norm", 5e-4, "absolute_norm", 5e-4]
    assert control(SceneConfig()) == ["signed", 3e-4, "signed", None]


def test_files_and_options_go_before_the_preset(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"version": 1, "flip_probability": 0.5, "iterations": 30_000}))
    config = resolve_config("streetgs", read_config(path), {"scale": 0.25, "sh_degree": 2})
    assert (config.flip_probability, config.scale, config.sh_degree) == (0.5, 0.25, 2)
    assert config.fourier_terms == 5
    assert config.colours_lr == pytest.approx(2.5e-3)  # the file's number of steps counts
    assert resolve_config(None, read_config(path)).fourier_terms == 1


def test_only_omnire_deforms_and_its_rate_rises_to_a_limit() -> None:
    assert resolve_config("omnire").deformable and not SceneConfig().deformable
    rates = [resolve_config("omnire", None, {"iterations": n}) for n in (30_000, 20_000, 1000)]
    assert [one.deformation_lr for one in rates] == pytest.approx(
        [8e-4, 8e-4 * 1.5**0.75, MOST_DEFORMATION_RATE]
    )
    assert not resolve_config("streetgs").deformable


def test_a_wrong_option_is_named() -> None:
    with pytest.raises(InputError, match="scale"):
        resolve_config("omnire", options={"scale": 3.0})


def test_a_preset_over_a_file_that_names_every_field_is_refused(tmp_path: Path) -> None:
    write_config(SceneConfig(), tmp_path / "config.json")
    with pytest.raises(InputError, match="omnire: changes nothing"):
        resolve_config("omnire", read_config(tmp_path / "config.json"))
    assert resolve_config(None, read_config(tmp_path / "config.json")) == SceneConfig()
