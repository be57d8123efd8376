"""`benchmarks/cuda.py`: one line without a GPU; with a stand-in for gsplat it runs through."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest
import torch

from support.stand_in_gsplat import install

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module."""
    monkeypatch.syspath_prepend(str(FOLDER))
    spec = spec_from_file_location("cuda_benchmark", FOLDER / "cuda.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_without_a_gpu_it_says_so(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    assert benchmark.main([]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == (
        "benchmarks/cuda.py: device: cuda: torch sees 0 GPUs; choose auto, cpu or cuda\n"
    )


def test_it_does_not_pass_for_the_package_of_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "cuda", raising=False)
    with pytest.raises(ModuleNotFoundError, match="NVIDIA"):
        import_module("cuda")


def test_it_runs_through(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules["recast.splats.rasterize"].DEVICE_OF, "gsplat", "cpu")
    install(monkeypatch)
    monkeypatch.setattr(benchmark, "WARM_UP", 1)
    size = ["--size", "32", "20", "--gaussians", "300", "--places", "2"]
    assert benchmark.main([*size, "--steps", "2", "--repeats", "1", "--device", "cpu"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(",")[0].split(" ")[0] for line in lines] == [
        "no",
        "rendering",
        "forward",
        "step",
        "training",
    ]
    assert "frames/s" in lines[1] and "peak memory" in lines[1]
    assert "gsplat directly" in lines[2] and "rasterize" in lines[2]
    assert "steps/s" in lines[4] and "dB" in lines[4]
