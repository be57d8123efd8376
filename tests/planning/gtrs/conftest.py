"""A tiny model with known answers, and a planner around it that needs no vocabulary of others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from recast.dynamics import make_state
from recast.planning import DrivingCommand, PlannerInput
from recast.planning.gtrs import (
    GtrsModel,
    GtrsPlanner,
    new_model,
)
from support.tiny_gtrs import GOLDEN, TINY, VIEWS, fan


@pytest.fixture(scope="session")
def tiny_io() -> dict[str, torch.Tensor]:
    return load_file(GOLDEN / "gtrs_tiny_io.safetensors")


@pytest.fixture(scope="session")
def tiny_weights() -> dict[str, torch.Tensor]:
    return load_file(GOLDEN / "gtrs_tiny_weights.safetensors")


@pytest.fixture
def tiny_model(tiny_weights: dict[str, torch.Tensor]) -> GtrsModel:
    """The golden head behind a backbone that has made-up weights."""
    model = new_model(TINY, torch.Generator().manual_seed(0))
    result = model.load_state_dict(tiny_weights, strict=False)
    assert all(name.startswith("_backbone.") for name in result.missing_keys)
    return model


@pytest.fixture(scope="session")
def released_vocabulary(shared: Path) -> torch.Tensor:
    """The 8192 published trajectories; they are not ours to copy."""
    return torch.from_numpy(np.load(shared / "golden" / "planners" / "vocab_8192.npy"))


@pytest.fixture(scope="session")
def tiny_vocabulary(released_vocabulary: torch.Tensor) -> torch.Tensor:
    """The 64 of them that the golden tiny model scores."""
    return released_vocabulary[::128]


@pytest.fixture
def planner() -> GtrsPlanner:
    model = new_model(TINY, torch.Generator().manual_seed(1))
    return GtrsPlanner(model, fan(12), VIEWS, name="tiny", top_k=3)


@pytest.fixture
def observation() -> PlannerInput:
    rng = np.random.default_rng(0)
    images = {name: rng.integers(0, 256, (32, 48, 3), np.uint8) for name in VIEWS.cameras}
    state = make_state([5.0, 0.1, 0.02], speed=6.0)
    return PlannerInput(0, 0, state, state[None], (), DrivingCommand.STRAIGHT, images)


@pytest.fixture
def released_keys() -> dict[str, tuple[int, ...]]:
    keys = json.loads((GOLDEN / "gtrs_keys.json").read_text())
    return {name: tuple(shape) for name, shape in keys.items()}
