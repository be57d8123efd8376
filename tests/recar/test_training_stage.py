"""A whole stage on the golden networks: what it writes, and that kills change nothing."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file

from recast.errors import InputError
from recast.recar.targets import TargetCache
from recast.recar.training.stage import train_stage
from recast.recar.training.stage_parts import StageRequest
from recast.recar.training.training_record import read_training_record
from recast.storage import read_json, write_json
from recast.trellis import ImageTo3D, verify_checkpoint
from recast.trellis.checkpoints import first_fault
from support.tiny_stage import TinyStage, train_quietly, write_tiny_stage

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


def killed(request: StageRequest, after: float | None) -> float:
    """Train in a process that is killed (SIGKILL) after so many seconds; gives how long it ran.

    Processes are forked from a server that has imported everything, so that kills meet training.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["support.tiny_stage_server"])
    # The server of Python 3.11 is not told sys.path, and its preloading would silently fail.
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    start = time.monotonic()
    process = context.Process(target=train_quietly, args=(request,))
    process.start()
    process.join(after)
    process.kill()
    process.join()
    if after is None:
        assert process.exitcode == 0
    return time.monotonic() - start


def survive(stage: TinyStage, out: Path, kills: int, seed: int) -> int:
    """Kill a training at random moments, let it end, and give how many kills met it running."""
    request = stage.request(out)
    killed(request, 0.0)  # starts the server, whose imports take seconds
    length = killed(stage.request(out.with_name("timed")), None)
    rng, met = np.random.default_rng(seed), 0
    for _ in range(kills):
        killed(request, float(rng.uniform(0, length)))
        met += not (out / "training.json").exists() or not read_training_record(out).complete
    killed(request, None)
    return met


def test_two_kills_change_nothing(stage: TinyStage, whole: Path, tmp_path: Path) -> None:
    assert survive(stage, tmp_path / "model", kills=2, seed=1) >= 1
    assert results(tmp_path / "model") == results(whole)


@pytest.mark.slow
def test_ten_kills_change_nothing(stage: TinyStage, whole: Path, tmp_path: Path) -> None:
    assert survive(stage, tmp_path / "model", kills=10, seed=2) >= 3
    assert results(tmp_path / "model") == results(whole)


def test_the_new_model_is_complete_and_only_the_flows_differ(stage: TinyStage, whole: Path) -> None:
    assert first_fault(verify_checkpoint(whole, values=True)) is None
    differ = {
        path.name for path in (stage.model / "ckpts").glob("*.safetensors")
        if path.read_bytes() != (whole / "ckpts" / path.name).read_bytes()
    }  # fmt: skip
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


def test_a_latent_flow_waits_for_the_encoder(stage: TinyStage, tmp_path: Path) -> None:
    request = stage.request(tmp_path / "model", train_encoder=True, structure={"steps": 2},
                            latent={"steps": 2})  # fmt: skip
    with pytest.raises(InputError, match="needs the image encoder"):
        train_stage(replace(request, flows=("latent",)), console=QUIET)
    assert train_stage(replace(request, flows=("structure",)), console=QUIET) == ("latent",)
    apart = trained(replace(request, flows=("latent",)))
    assert results(apart) == results(trained(replace(request, out=tmp_path / "whole")))


def test_the_encoder_trains_with_the_structure_where_asked(
    stage: TinyStage, tmp_path: Path
) -> None:
    request = stage.request(tmp_path / "model", train_encoder=True, structure={"steps": 2},
                            latent={"steps": 2})  # fmt: skip
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
    refused("1 vehicles with a target have none: van", changed.request(out))

    larger = shutil.copytree(stage.targets, tmp_path / "larger")
    record = read_json(larger / "cache.json")
    record["model"]["resolution"] *= 2
    write_json(larger / "cache.json", record)
    changed = TinyStage(stage.model, larger, stage.pictures)
    refused("resolution: of the targets is", changed.request(out))

    changed = TinyStage(stage.model, stage.targets, tmp_path)
    refused("pictures: no set.json", changed.request(out))
    with pytest.raises(ValueError, match="a batch of 2 accumulated in 3 parts"):
        stage.request(out, structure={"accumulate": 3})


def test_another_training_or_a_foreign_folder_is_refused(
    stage: TinyStage, whole: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"training\.json: inputs\.config: differs"):
        train_stage(stage.request(whole, weights="raw"), console=QUIET)
    with pytest.raises(InputError, match="settings: differ from those asked for \\(lr\\)"):
        train_stage(stage.request(whole, structure={"lr": 2e-3}), console=QUIET)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="holds something else"):
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
    train_stage(stage.request(tmp_path / "model", probe=0, structure={"steps": 20}, latent=None),
                console=QUIET)  # fmt: skip
    assert set(read) == {"car-0", "car-1", "car-2", "car-3"}
