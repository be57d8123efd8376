"""Golden vectors of the image-to-3D networks; tests/golden/trellis/README.md describes each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

FOLDER = Path(__file__).parents[1] / "golden" / "trellis"

FLOAT32, FLOAT16 = 2.0**-24, 2.0**-11
"""Relative error of one rounding."""

RELATIVE = 1e-5
"""168 roundings of float32: what sums of some hundred terms in another order may differ by."""

AFTER_TIME = 1000 * 5 * FLOAT32
"""What may differ behind the embedding of a diffusion time of up to 1000. The published code
computes its angles in float32, of which five roundings (constant, product, division, exponential,
product) move cosines by up to 3e-4, otherwise on every processor; ours are of float64. The weights
of the golden networks are drawn from N(0, 1 / fan_in), so that layers carry errors on as they are.
"""


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


def half_bound(model: nn.Module) -> float:
    """How far a network with layers in half precision may lie from itself in float32.

    Relative to its largest output: every layer in half precision rounds its weights and what it
    returns, and the layers behind it carry that on as it is (see `AFTER_TIME`).
    """
    layers = sum(
        any(parameter.dtype == torch.float16 for parameter in module.parameters(recurse=False))
        for module in model.modules()
    )
    assert layers > 0
    return 2 * layers * FLOAT16


@torch.no_grad()
def randomise(model: torch.nn.Module, generator: torch.Generator) -> None:
    """Weights of unit gain, none zero, so that every layer acts on the output."""
    for name, parameter in model.named_parameters():
        is_gain = name.endswith("gamma") or "norm" in name.split(".")[-2]
        if is_gain and not name.endswith("bias"):
            parameter.fill_(1.0)
        else:
            fan_in = parameter.shape[-1] if parameter.ndim > 1 else 100
            # drawn in float32: half-precision draws take minutes on a CPU
            drawn = torch.empty(parameter.shape).normal_(std=fan_in**-0.5, generator=generator)
            parameter.copy_(drawn)
