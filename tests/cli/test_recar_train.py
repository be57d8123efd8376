"""`recast recar train`."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import tyro

from recast.cli.recar import RecarTrain
from recast.core.errors import InputError
from recast.core.files import write_json
from recast.recar.training_config import read_training_record
from support.tiny_stage import TinyStage, tiny_config, write_tiny_stage


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> TinyStage:
    return write_tiny_stage(tmp_path_factory.mktemp("cli"))


def arguments(stage: TinyStage, out: Path) -> list[str]:
    return [
        "--model",
        str(stage.model),
        "--targets",
        str(stage.targets),
        "--set",
        str(stage.pictures),
        "--out",
        str(out),
        "--device",
        "cpu",
    ]


def run(args: list[str]) -> None:
    tyro.cli(RecarTrain, args=args)()


def test_a_config_file_is_trained(
    stage: TinyStage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "stage.json", tmp_path / "model"
    write_json(path, tiny_config(structure={"steps": 2}).model_dump(mode="json"))
    run([*arguments(stage, out), "--config", str(path), "--flow", "structure"])
    record = read_training_record(out)
    assert not record.complete
    shown = capsys.readouterr().out
    assert "structure 2/2  loss" in shown and "gap" in shown
    assert "latent still to train" in shown
    run([*arguments(stage, out), "--config", str(path)])
    record = read_training_record(out)
    assert record.complete and record.flows.keys() == {"structure", "latent"}
    assert "wrote" in capsys.readouterr().out


def test_a_flow_that_the_stage_leaves_alone(stage: TinyStage, tmp_path: Path) -> None:
    path = tmp_path / "stage.json"
    write_json(path, tiny_config(latent=None).model_dump(mode="json"))
    with pytest.raises(InputError, match="latent: is not trained by"):
        run([*arguments(stage, tmp_path / "m"), "--config", str(path), "--flow", "latent"])


def test_neither_stage_nor_config(stage: TinyStage, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing, and so is `config`"):
        run(arguments(stage, tmp_path / "model"))


@pytest.mark.skipif(
    importlib.util.find_spec("tensorboard") is not None, reason="tensorboard is installed"
)
def test_tensorboard_that_is_not_installed_is_one_line(stage: TinyStage, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="tensorboard is not installed"):
        run([*arguments(stage, tmp_path / "model"), "--stage", "1", "--tensorboard"])
