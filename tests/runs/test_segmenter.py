"""The segmenter of a run: which one, and when the actor is made again."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pydantic import TypeAdapter

from recast.actors import MaskQuality, observe, segmenter_of
from recast.logs import DrivingLog
from recast.runs.actor import save_observation
from recast.runs.config import RunConfig, resolve_config
from recast.runs.sources import segmenter_source
from support.tiny_networks import write_tiny_networks


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_networks(tmp_path_factory.mktemp("networks"))


def test_other_weights_make_another_actor(networks: Path, tmp_path: Path) -> None:
    assert segmenter_source("box-lidar") == "box-lidar"
    copy = tmp_path / "copy"
    shutil.copytree(networks, copy)
    assert segmenter_source(str(copy)) == segmenter_source(str(networks))
    with (copy / "sam/config.json").open("a") as config:
        config.write(" ")
    assert segmenter_source(str(copy)) != segmenter_source(str(networks))


def test_the_option_goes_before_the_file(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    config = RunConfig(track="0", motions=("cut-in-a",), segmenter="networks")
    path.write_text(config.model_dump_json())
    assert resolve_config("0", (), path, None, {"segmenter": None}, {}).segmenter == "networks"
    assert resolve_config("0", (), path, None, {"segmenter": "x"}, {}).segmenter == "x"
    assert RunConfig(track="0", motions=("cut-in-a",)).segmenter == "box-lidar"


def test_an_observation_by_grounding_dino_and_sam(
    networks: Path, tiny_log: DrivingLog, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Random networks give a poor mask, and the record says so."""
    observation = observe(tiny_log, "0", segmenter=segmenter_of(str(networks)))
    assert "".join(capfd.readouterr()) == "", "no progress bar, no word of torchvision"
    save_observation(observation, tiny_log, tmp_path)
    explanation = (tmp_path / "explanation.txt").read_text()
    assert "mask: fills " in explanation
    assert "box from the " in explanation
    assert "warning: " in explanation
    with Image.open(tmp_path / "crop.png") as crop:
        assert 0 < np.asarray(crop)[..., 3].mean() < 255


def test_the_record_keeps_the_segmenters_words() -> None:
    record = TypeAdapter(MaskQuality)
    shares = {"box_coverage": 0.7, "border_contact": 0.0, "lidar_inside": 1.0, "lidar_outside": 0.9}
    quality = MaskQuality(**shares, notes=("box from the log",), doubts=("it stood in",))
    assert record.validate_json(record.dump_json(quality)) == quality
    assert quality.warnings() == ("it stood in",)
    assert record.validate_python(shares).notes == (), "a record from before"
