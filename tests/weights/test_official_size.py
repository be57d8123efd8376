"""TRELLIS at its published size, with random weights: fetched by name from loopback, and run."""

from __future__ import annotations

import gc
import json
import resource
import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from recast.actors import load_actor
from recast.cli.main import main
from recast.trellis.checkpoint_sizes import OFFICIAL, new_checkpoint
from recast.trellis.model_files import save_checkpoint
from recast.weights import PUBLISHED, weights_folder
from support.trellis import randomise
from weights.hub import Content, Hub


def write_models(folder: Path) -> None:
    """The published networks with random weights, one sampling step, and few voxels."""
    generator = torch.Generator().manual_seed(0)
    made = new_checkpoint(OFFICIAL, seed=0, with_encoder=False)
    for model in made.models.values():
        randomise(model, generator)
    # Behind norm and SiLU the values have a root mean square of 0.6, so that with these weights the
    # logits deviate by 0.5: the bias leaves two or three deviations, at most 2 % of 64^3 voxels.
    decoder = made.models["sparse_structure_decoder"]
    gain, last, bias = (
        decoder.get_parameter(f"out_layer.{name}") for name in ("0.weight", "2.weight", "2.bias")
    )
    with torch.no_grad():
        gain.fill_(1.0)
        last.copy_(torch.empty(last.shape).normal_(std=(32 * 27) ** -0.5, generator=generator))
        bias.fill_(-1.5)
    save_checkpoint(folder, made.record, made.models)
    told = json.loads((folder / "pipeline.json").read_text())
    for sampler in ("sparse_structure_sampler", "slat_sampler"):
        told["args"][sampler]["params"]["steps"] = 1
    (folder / "pipeline.json").write_text(json.dumps(told))


def write_backbone(folder: Path) -> None:
    """DINOv2 ViT-L/14 with registers as its repository has it, with the first weights."""
    from transformers import Dinov2WithRegistersConfig, Dinov2WithRegistersModel

    torch.manual_seed(0)
    config = Dinov2WithRegistersConfig(
        hidden_size=1024,
        num_hidden_layers=24,
        num_attention_heads=16,
        image_size=518,
        patch_size=14,
        num_register_tokens=4,
    )
    Dinov2WithRegistersModel(config).save_pretrained(folder)
    (folder / "preprocessor_config.json").write_text("{}")


@pytest.mark.slow
def test_the_official_size_by_name(
    hub: Hub,
    tmp_path: Path,
    tiny_log_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.undo()  # large chunks, and the waits between tries
    monkeypatch.setenv("RECAST_WEIGHTS_MIRROR", hub.address)
    monkeypatch.setenv("RECAST_WEIGHTS", str(tmp_path / "weights"))
    entry = PUBLISHED["trellis"]
    for source, write in zip(entry.sources, (write_models, write_backbone), strict=True):
        folder = tmp_path / source.where
        write(folder)
        files: dict[str, Content] = {name: folder / name for name in source.files}
        assert all((folder / name).is_file() for name in source.files), "the table's names"
        hub.commit(source.where, files)
        gc.collect()
    sources = tuple(replace(source, revision=None, sha256={}) for source in entry.sources)
    monkeypatch.setitem(PUBLISHED, "trellis", replace(entry, sources=sources))  # type: ignore[arg-type]
    size = sum(
        (tmp_path / source.where / name).stat().st_size
        for source in entry.sources
        for name in source.files
    )

    started = time.perf_counter()
    hub.cuts = [50_000_000]  # the first transfer is cut once
    assert main(["weights", "get", "trellis"]) == 0
    fetched = time.perf_counter() - started
    assert any(asked[2] for asked in hub.files_asked()), "continued"
    hub.stop()
    for source in entry.sources:
        shutil.rmtree(tmp_path / source.where)

    started, spent = time.perf_counter(), time.process_time()
    command = ["actor", "make", str(tiny_log_folder), "--track", "0", "--generator", "trellis"]
    assert main([*command, "--out", str(tmp_path / "car")]) == 0
    ran, spent = time.perf_counter() - started, time.process_time() - spent
    actor = load_actor(tmp_path / "car" / "actor")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with capsys.disabled():
        print(
            f"\nTRELLIS and DINOv2 at their published size: {size / 1e9:.2f} GB fetched in "
            f"{fetched:.0f} s; actor make --generator trellis, one step each, "
            f"{torch.get_num_threads()} threads: {ran:.0f} s ({spent:.0f} s of CPU), "
            f"{len(actor.gaussians)} Gaussians, peak memory {peak:.1f} GiB"
        )
    shutil.rmtree(weights_folder())  # 4.2 GB that pytest would keep
    assert len(actor.gaussians) > 0 and bool(actor.gaussians.means.isfinite().all())
