"""Figures of the stages, and the files that change them."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar.training_config import (
    BASE,
    MINI_STAGE_1,
    MINI_STAGE_2,
    PRESETS,
    STAGE_1,
    STAGE_2,
    chosen_stage,
    read_stage_config,
)


def test_the_presets_are_the_papers() -> None:
    for stage, rate, steps in ((STAGE_1, 1e-5, (10_000, 16_000)), (STAGE_2, 2e-6, (12_000,) * 2)):
        assert stage.structure and stage.latent
        assert (stage.structure.steps, stage.latent.steps) == steps
        for settings in stage.settings.values():
            assert (settings.lr, settings.ema_decay) == (rate, 0.9999)
            assert settings.schedule == "constant" and settings.weight_decay == 0
        assert (stage.objective.batch, stage.objective.condition_drop) == (2, 0.1)
        assert (stage.objective.time_mean, stage.objective.time_std) == (1.0, 1.0)
        assert not stage.train_encoder
    assert STAGE_1.perturbation is None
    assert STAGE_2.perturbation and STAGE_2.perturbation.rho_clean == 0.2
    assert MINI_STAGE_1.perturbation is None
    assert MINI_STAGE_2.perturbation == STAGE_2.perturbation
    assert not BASE.train_encoder  # its tokens are kept


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_written_out_in_full_reads_back(name: str, tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(path, PRESETS[name].model_dump(mode="json"))
    assert read_stage_config(path) == PRESETS[name]


def test_a_file_changes_a_preset_member_by_member(tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(
        path,
        {
            "preset": "stage-2",
            "structure": {"steps": 7},
            "latent": None,
            "perturbation": {"rho_clean": 0.5},
        },
    )
    found = read_stage_config(path)
    assert found.structure and STAGE_2.structure and found.perturbation
    assert found.structure == STAGE_2.structure.model_copy(update={"steps": 7})
    assert found.latent is None and found.perturbation.rho_clean == 0.5
    assert found.settings.keys() == {"structure"}


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"preset": "stage-3"}, "preset: is 'stage-3'"),
        ({"preset": "stage-1", "structure": {"steps": 0}}, "structure.steps"),
        ({"preset": "stage-1", "learning_rate": 1}, "learning_rate"),
        ({"preset": "stage-1", "structure": {"ema_decay": None}}, "ema_decay is null"),
        (
            {"preset": "base", "structure": None, "train_encoder": True},
            "the encoder can only train with the structure flow",
        ),
        ({"name": "x"}, "structure: Field required"),
        ([1], "is not an object"),
    ],
)
def test_a_wrong_file_is_refused(values: object, match: str, tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(path, values)
    with pytest.raises(InputError, match=match):
        read_stage_config(path)


def test_the_stage_of_a_command(tmp_path: Path) -> None:
    assert chosen_stage("1", None) is not None
    assert chosen_stage("2", None).name == "stage-2"
    assert chosen_stage("mini-2", None).name == "mini-stage-2"
    path = tmp_path / "stage.json"
    write_json(path, {"preset": "stage-1", "latent": None})
    assert chosen_stage(None, path).settings.keys() == {"structure"}
    for stage, file in ((None, None), ("1", path)):
        with pytest.raises(InputError, match="`stage`"):
            chosen_stage(stage, file)
