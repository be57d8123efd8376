from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.scene import SceneConfig, read_config, write_config


def test_round_trip(tmp_path: Path) -> None:
    config = SceneConfig(iterations=7, cameras=("image_02",), seed=3)
    write_config(config, tmp_path / "config.json")
    assert read_config(tmp_path / "config.json") == config


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"version": 99}, "version"),
        ({"version": None}, "version"),
        ({"iterations": 0}, "iterations"),
        ({"scale": "half"}, "scale"),
        ({"iteration": 5}, "iteration"),
    ],
)
def test_wrong_configurations_name_file_and_field(
    tmp_path: Path, change: dict[str, object], field: str
) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps({**SceneConfig().model_dump(), **change}))
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert caught.value.where == str(path) and caught.value.field == field


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing"):
        read_config(tmp_path / "none.json")


def test_a_record_without_the_youngest_fields_says_the_same(tmp_path: Path) -> None:
    plain, other = SceneConfig(iterations=7), SceneConfig(densify_pause=0.5)
    assert "densify_by" not in plain.resolved() and "densify_gradient" in plain.resolved()
    assert other.resolved()["densify_pause"] == 0.5
    for config in (plain, other):
        assert SceneConfig.model_validate(config.resolved()) == config
        assert SceneConfig.model_validate(config.resolved()).is_whole()
    assert not plain.is_whole()
