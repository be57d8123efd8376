from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.reconstruction import SceneConfig, read_config, write_config


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


def test_the_record_of_a_run_is_whole() -> None:
    plain = SceneConfig(iterations=7)
    assert not plain.is_whole()
    assert SceneConfig.model_validate(plain.model_dump(mode="json")) == plain
    assert SceneConfig.model_validate(plain.model_dump(mode="json")).is_whole()
