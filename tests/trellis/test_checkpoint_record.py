"""`pipeline.json`: the published one goes through unchanged, wrong ones end in a line."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from recast.core.errors import InputError
from recast.trellis.checkpoint_sizes import OFFICIAL
from recast.trellis.model_files import read_pipeline, write_pipeline
from support.trellis_folder import golden_pipeline

STEM = "ckpts/slat_dec_rf_swin8_B_64l8r16_fp16"


def published() -> dict[str, Any]:
    """As the published checkpoints have it, with all decoders."""
    pipeline: dict[str, Any] = OFFICIAL.record.model_dump(mode="json")
    models = pipeline["args"]["models"]
    del models["sparse_structure_encoder"], models["slat_encoder"]
    models["slat_decoder_rf"] = STEM
    models["slat_decoder_mesh"] = STEM.replace("rf", "mesh")
    return pipeline


@pytest.mark.parametrize("pipeline", [published(), golden_pipeline()])
def test_a_record_is_written_as_it_was_read(tmp_path: Path, pipeline: dict[str, Any]) -> None:
    pipeline["args"]["later"] = {"members": ["are", "kept"]}
    pipeline["version"] = 2
    (tmp_path / "pipeline.json").write_text(json.dumps(pipeline))
    record = read_pipeline(tmp_path)
    (tmp_path / "again").mkdir()
    write_pipeline(tmp_path / "again", record)
    assert json.loads((tmp_path / "again" / "pipeline.json").read_text()) == pipeline


def test_what_a_record_says(tmp_path: Path) -> None:
    (tmp_path / "pipeline.json").write_text(json.dumps(golden_pipeline()))
    record = read_pipeline(tmp_path)
    assert record.sparse_structure_settings.steps == 6
    assert record.slat_settings.steps == 4
    assert record.slat_settings.cfg_interval == (0.5, 1.0)
    assert record.slat_statistics[0][0] == pytest.approx(-2.16875457)
    assert record.encoder_role == "image_encoder"
    assert OFFICIAL.record.encoder_role is None


def test_a_record_is_never_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        OFFICIAL.record.args.image_cond_model = "x"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.pop("args"), "args: Field required"),
        (lambda p: p.update(name="TrellisTextTo3DPipeline"), "name: .*TrellisImageTo3DPipeline"),
        (lambda p: p["args"].pop("slat_sampler"), "slat_sampler: Field required"),
        (lambda p: p["args"].update(slat_sampler=3), "slat_sampler: is not an object"),
        (
            lambda p: p["args"]["slat_sampler"].update(name="Heun"),
            "slat_sampler: name Input",
        ),
        (lambda p: p["args"]["slat_sampler"]["params"].update(steps="25"), "slat_sampler: steps"),
        (
            lambda p: p["args"]["slat_sampler"]["params"].pop("rescale_t"),
            "rescale_t Field",
        ),
        (lambda p: p["args"].update(models=[1]), "models: .*object"),
        (lambda p: p["args"]["models"].update(slat_encoder=1), "models.slat_encoder: .*string"),
        (
            lambda p: p["args"]["models"].update(slat_encoder="../x"),
            "is not a path inside the folder",
        ),
        (
            lambda p: p["args"]["models"].update(slat_encoder="a/../../x"),
            "is not a path inside the folder",
        ),
        (
            lambda p: p["args"]["models"].update(slat_encoder="/etc/x"),
            "is not a path inside the folder",
        ),
        (
            lambda p: p["args"]["models"].update(slat_encoder="a\0b"),
            "is not a path inside the folder",
        ),
        (lambda p: p["args"]["models"].update(slat_encoder=""), "is not a path inside the folder"),
        (lambda p: p["args"]["models"].update(slat_encoder="a\\b"), "forward slashes"),
        (lambda p: p["args"]["slat_normalization"].update(mean=[0.0]), "1 means, 8 standard"),
        (lambda p: p["args"]["slat_normalization"].update(mean=["0"] * 8), "valid number"),
        (lambda p: p["args"]["slat_normalization"].update(std=[0.0] * 8), "greater than 0"),
        (lambda p: p["args"]["slat_normalization"].update(std=[float("nan")] * 8), "finite"),
        (lambda p: p["args"].update(image_cond_model=None), "image_cond_model: .*string"),
    ],
)
def test_a_wrong_record(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    pipeline = copy.deepcopy(golden_pipeline())
    change(pipeline)
    (tmp_path / "pipeline.json").write_text(json.dumps(pipeline))
    with pytest.raises(InputError, match=message) as caught:
        read_pipeline(tmp_path)
    assert caught.value.where == str(tmp_path / "pipeline.json")


@pytest.mark.parametrize("text", ["", "{", "[]", "3"])
def test_a_record_that_is_no_json_object(tmp_path: Path, text: str) -> None:
    (tmp_path / "pipeline.json").write_text(text)
    with pytest.raises(InputError, match=r"pipeline\.json"):
        read_pipeline(tmp_path)


def test_no_record(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pipeline\.json: is missing"):
        read_pipeline(tmp_path)
