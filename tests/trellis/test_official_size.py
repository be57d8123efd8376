"""The official sizes on this machine: written, checked, loaded, and one forward."""

from __future__ import annotations

import gc
import resource
import shutil
import time
from pathlib import Path

import pytest
import torch

from recast.trellis.checkpoint_sizes import OFFICIAL, new_checkpoint
from recast.trellis.checkpoints import load_checkpoint, verify_checkpoint
from recast.trellis.model_files import save_checkpoint
from support.trellis import randomise


@pytest.mark.slow
@torch.no_grad()
def test_official_sizes_are_written_loaded_and_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    generator = torch.Generator().manual_seed(0)
    made = new_checkpoint(OFFICIAL, seed=0, with_encoder=False)
    for model in made.models.values():
        randomise(model, generator)
    folder = tmp_path / "official"
    save_checkpoint(folder, made.record, made.models)
    del made, model
    gc.collect()
    assert not any(check.fault() for check in verify_checkpoint(folder))

    started = time.perf_counter()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    loaded = load_checkpoint(folder, device=device, with_encoder=False)
    seconds = time.perf_counter() - started
    flow = loaded.models["sparse_structure_flow_model"]
    x = torch.randn(1, 8, 16, 16, 16, generator=generator).to(device)
    cond = torch.randn(1, 1374, 1024, generator=generator).to(device)
    started, spent = time.perf_counter(), time.process_time()
    out = flow(x, torch.tensor([500.0], device=device), cond)
    assert torch.isfinite(out).all()
    ran, spent = time.perf_counter() - started, time.process_time() - spent
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with capsys.disabled():
        print(
            f"\nofficial sizes on {device}, {torch.get_num_threads()} threads: four networks "
            f"loaded in {seconds:.0f} s, one forward of the structure flow {ran:.0f} s "
            f"({spent:.0f} s of CPU), peak memory {peak:.1f} GiB"
        )
    shutil.rmtree(folder)  # 2.8 GB that pytest would keep
    assert out.shape == x.shape
    assert float(out.std()) > 0.1
