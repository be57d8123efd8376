"""A whole stage on the golden networks: what it writes; kills are in test_moments.py."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from io import StringIO
from pathlib import Path

import cv2
import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file

from recast.core.errors import InputError
from recast.core.files import read_json, write_json
from recast.recar.target_cache import TargetCache
from recast.recar.training import StageRequest, train_stage
from recast.recar.training_config import read_training_record
from recast.trellis import ImageTo3D, verify_checkpoint
from recast.trellis.checkpoints import first_fault
from support.tiny_stage import TinyStage, write_tiny_stage

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> TinyStage:
    return write_tiny_stage(tmp_path_factory.mktemp("stage"))


@pytest.fixture(scope="module")
def whole(stage: TinyStage, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained without interruption."""
    return trained(stage.request(tmp_path_factory.mktemp("out") / "model"))


def trained(request: StageRequest) -> Path:
    assert train_stage(request, console=QUIET) == ()
    return request.out


def results(out: Path) -> dict[str, bytes]:
    """All files but those that hold times, and sheets."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.suffix not in (".jsonl", ".png") and path.parent != out
    }


def test_the_new_model_is_complete_and_only_the_flows_differ(stage: TinyStage, whole: Path) -> None:
    assert first_fault(verify_checkpoint(whole, values=True)) is None
    differ = {
        path.name
        for path in (stage.model / "ckpts").glob("*.safetensors")
        if path.read_bytes() != (whole / "ckpts" / path.name).read_bytes()
    }
    assert differ == {"ss_flow.safetensors", "slat_flow.safetensors"}
    assert (whole / "pipeline.json").read_bytes() == (stage.model / "pipeline.json").read_bytes()
    ImageTo3D.load(whole, device="cpu")


def test_the_average_is_written_or_the_latest_weights(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    raw = trained(stage.request(tmp_path / "raw", weights="raw", latent=None))
    state = load_file(whole / "training" / "structure" / "state.safetensors")
    for out, prefix in ((whole, "average/flow/"), (raw, "model/flow/")):
        written = load_file(out / "ckpts" / "ss_flow.safetensors")
        for name, value in written.items():
            assert torch.equal(value, state[prefix + name]), name
    assert read_training_record(raw).weights == "raw"
    latents = [folder / "ckpts" / "slat_flow.safetensors" for folder in (raw, stage.model)]
    assert latents[0].read_bytes() == latents[1].read_bytes()


def test_the_record_says_what_was_trained_from_what(stage: TinyStage, whole: Path) -> None:
    record = read_training_record(whole)
    assert record.complete and record.weights == "average"
    assert (record.inputs.train, record.inputs.held_out) == (4, 2)
    assert record.inputs.config == stage.request(whole).config
    assert (record.inputs.model, record.inputs.pictures) == ("model", "set")
    assert record.flows["structure"].steps == record.flows["latent"].steps == 6
    assert {"loss", "gap", "held_out", "shuffled"} <= record.flows["latent"].last.keys()
    assert record.flows["latent"].seconds > 0 and record.peak_bytes


def test_a_stage_continues_from_the_model_of_the_last(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    following = TinyStage(whole, stage.targets, stage.pictures)
    request = following.request(
        tmp_path / "two", structure=None, latent={"steps": 2}, perturbation={}, train_encoder=False
    )
    out = trained(request)
    lines = [json.loads(x) for x in (out / "training/latent/log.jsonl").read_text().splitlines()]
    assert lines[-1]["altered"] > 0
    kept = [folder / "ckpts" / "ss_flow.safetensors" for folder in (whole, out)]
    assert kept[0].read_bytes() == kept[1].read_bytes()


def test_sheets_show_held_out_vehicles_and_leave_the_training_alone(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    request = stage.request(tmp_path / "model", sheet_every=4)
    out = trained(request)
    sheets = sorted(path.name for path in (out / "sheets").iterdir())
    assert sheets == ["latent-0000004.png", "structure-0000004.png"]
    picture = cv2.imread(str(out / "sheets" / sheets[0]))
    assert picture.shape == (182, 7 * 164, 3)
    assert picture[30:150, 10:150].std() > 10  # the input, on black
    assert picture[30:150, 170:320].std() > 1  # something was sampled
    assert results(out) == results(whole)


def test_flows_that_are_trained_apart_make_the_same_model(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    request = stage.request(tmp_path / "model")
    assert train_stage(replace(request, flows=("latent",)), console=QUIET) == ("structure",)
    assert not (request.out / "pipeline.json").exists()
    assert not read_training_record(request.out).complete
    trained(replace(request, flows=("structure",)))
    assert results(request.out) == results(whole)
    assert read_training_record(request.out).flows.keys() == {"structure", "latent"}


def test_targets_that_nobody_screened_are_told_once_and_recorded(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    def said(changed: TinyStage, out: Path) -> str:
        stream = StringIO()
        train_stage(
            changed.request(out, structure={"steps": 1}, latent={"steps": 1}),
            console=Console(file=stream, width=400),
        )
        return stream.getvalue()

    assert read_training_record(whole).unscreened == 4
    text = said(stage, tmp_path / "none")
    assert text.count("4 of the 4 training targets are not screened") == 1
    screened = TinyStage(stage.model, tmp_path / "cache", stage.pictures)
    shutil.copytree(stage.targets, screened.targets)
    table = screened.targets / "screening.csv"
    table.write_text("id,keep\ncar-0,yes\ncar-1,yes\ncar-2,yes\n")
    assert "1 of the 4 training targets are not screened" in said(screened, tmp_path / "some")
    assert read_training_record(tmp_path / "some").unscreened == 1
    table.write_text(table.read_text() + "car-3,yes\n")
    assert "screened" not in said(screened, tmp_path / "all")
    assert read_training_record(tmp_path / "all").unscreened == 0


def test_a_latent_flow_waits_for_the_encoder(stage: TinyStage, tmp_path: Path) -> None:
    request = stage.request(
        tmp_path / "model", train_encoder=True, structure={"steps": 2}, latent={"steps": 2}
    )
    with pytest.raises(InputError, match="needs the image encoder"):
        train_stage(replace(request, flows=("latent",)), console=QUIET)
    assert train_stage(replace(request, flows=("structure",)), console=QUIET) == ("latent",)
    apart = trained(replace(request, flows=("latent",)))
    assert results(apart) == results(trained(replace(request, out=tmp_path / "whole")))


def test_the_encoder_trains_with_the_structure_where_asked(
    stage: TinyStage, tmp_path: Path
) -> None:
    request = stage.request(
        tmp_path / "model", train_encoder=True, structure={"steps": 2}, latent={"steps": 2}
    )
    out = trained(request)
    name = "ckpts/dinov2_tiny.safetensors"
    assert (out / name).read_bytes() != (stage.model / name).read_bytes()
    assert first_fault(verify_checkpoint(out, values=True)) is None


def test_inputs_that_do_not_belong_together_are_refused(stage: TinyStage, tmp_path: Path) -> None:
    def refused(match: str, request: StageRequest) -> None:
        with pytest.raises(InputError, match=match):
            train_stage(request, console=QUIET)
        assert not request.out.exists()

    out = tmp_path / "out"
    wrong_split = shutil.copytree(stage.targets, tmp_path / "wrong_split")
    one = wrong_split / "records" / "car-0.json"
    write_json(one, read_json(one) | {"split": "held-out"})
    changed = TinyStage(stage.model, wrong_split, stage.pictures)
    refused("split: of 1 vehicles differs from that of the set: car-0", changed.request(out))

    renamed = shutil.copytree(stage.targets, tmp_path / "renamed")
    write_json(renamed / "records" / "van.json", read_json(one) | {"id": "van"})
    (renamed / "records" / "car-0.json").unlink()
    changed = TinyStage(stage.model, renamed, stage.pictures)
    refused("1 vehicles with a target have no images: van", changed.request(out))

    larger = shutil.copytree(stage.targets, tmp_path / "larger")
    record = read_json(larger / "cache.json")
    record["model"]["resolution"] *= 2
    write_json(larger / "cache.json", record)
    changed = TinyStage(stage.model, larger, stage.pictures)
    refused("resolution: of the targets is", changed.request(out))

    changed = TinyStage(stage.model, stage.targets, tmp_path)
    refused("pictures: the folder contains no set.json", changed.request(out))
    with pytest.raises(ValueError, match="a batch of 2 does not split into 3 parts"):
        stage.request(out, structure={"accumulate": 3})


def test_another_training_or_a_foreign_folder_is_refused(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"training\.json: inputs\.config: differs"):
        train_stage(stage.request(whole, weights="raw"), console=QUIET)
    with pytest.raises(InputError, match="settings: differ from the requested ones \\(lr\\)"):
        train_stage(stage.request(whole, structure={"lr": 2e-3}), console=QUIET)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="contains other files"):
        train_stage(stage.request(tmp_path), console=QUIET)


def test_held_out_vehicles_are_never_trained_on(
    stage: TinyStage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    target = TargetCache.target

    def recorded(cache: TargetCache, identity: str) -> object:
        read.append(identity)
        return target(cache, identity)

    monkeypatch.setattr(TargetCache, "target", recorded)
    train_stage(
        stage.request(tmp_path / "model", probe=0, structure={"steps": 20}, latent=None),
        console=QUIET,
    )
    assert set(read) == {"car-0", "car-1", "car-2", "car-3"}
