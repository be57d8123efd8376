"""Golden vectors of the image-to-3D networks; tests/golden/trellis/README.md describes each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

FOLDER = Path(__file__).parents[1] / "golden" / "trellis"
RELATIVE = 1e-5


def golden_tensors(name: str) -> dict[str, Tensor]:
    """Tensors of one file, such as `ss_flow` (weights) or `ss_flow_io` (inputs and outputs)."""
    return load_file(FOLDER / f"{name}.safetensors")


def golden_config(name: str) -> dict[str, Any]:
    """`{"name": class, "args": {...}}` of a tiny model, in the published schema."""
    config: dict[str, Any] = json.loads((FOLDER / "configs" / f"{name}.json").read_text())
    return config


def official_keys() -> dict[str, Any]:
    """Class, arguments, names, shapes and dtypes of the published checkpoints, by stem."""
    keys: dict[str, Any] = json.loads((FOLDER / "keys.json").read_text())
    return keys


def assert_same(found: Tensor, expected: Tensor, relative: float = RELATIVE) -> None:
    """Fail unless the largest difference is within `relative` of the largest expected value."""
    assert found.shape == expected.shape, (found.shape, expected.shape)
    assert bool(torch.isfinite(found).all())
    error = float((found.double() - expected.double()).abs().max())
    scale = float(expected.double().abs().max())
    assert error <= relative * scale, f"relative error {error / scale:.2e}"
