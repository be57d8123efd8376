"""One forward of the official-size sparse-structure flow on the CPU: time and peak memory."""

from __future__ import annotations

import os
import resource
import time

import pytest
import torch
from tests.support.trellis import official_keys

from recast.trellis.models.ss_flow import SparseStructureFlowConfig, SparseStructureFlowModel


@torch.no_grad()
def randomise(model: torch.nn.Module, generator: torch.Generator) -> None:
    """Weights of unit gain, none zero, so that every layer acts on the output."""
    for name, parameter in model.named_parameters():
        is_gain = name.endswith("gamma") or "norm" in name.split(".")[-2]
        if is_gain and not name.endswith("bias"):
            parameter.fill_(1.0)
        else:
            fan_in = parameter.shape[-1] if parameter.ndim > 1 else 100
            parameter.normal_(std=fan_in**-0.5, generator=generator)


@pytest.mark.slow
@pytest.mark.skipif(
    os.environ.get("RECAST_SLOW") != "1", reason="2 minutes and 3 GB; set RECAST_SLOW=1"
)
@torch.no_grad()
def test_official_size_runs_on_the_cpu(capsys: pytest.CaptureFixture[str]) -> None:
    args = official_keys()["ss_flow_img_dit_L_16l8_fp16"]["args"]
    generator = torch.Generator().manual_seed(0)
    started = time.perf_counter()
    with torch.device("meta"):
        config = SparseStructureFlowConfig(**args)
        model = SparseStructureFlowModel(config)
    model.set_torso_dtype(torch.float32)
    model.to_empty(device="cpu").eval()
    model.pos_emb.copy_(
        SparseStructureFlowModel(config.model_copy(update={"num_blocks": 0})).pos_emb
    )
    randomise(model, generator)
    built, spent = time.perf_counter(), time.process_time()
    x = torch.randn(1, 8, 16, 16, 16, generator=generator)
    cond = torch.randn(1, 1374, 1024, generator=generator)
    out = model(x, torch.tensor([500.0]), cond)
    ran, spent = time.perf_counter(), time.process_time() - spent
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with capsys.disabled():
        print(
            f"\nofficial sparse-structure flow, fp32, {torch.get_num_threads()} threads: "
            f"built in {built - started:.0f} s, one forward {ran - built:.0f} s "
            f"({spent:.0f} s of CPU), peak memory {peak:.2f} GiB"
        )
    assert out.shape == x.shape
    assert torch.isfinite(out).all()
    assert float(out.std()) > 0.1
