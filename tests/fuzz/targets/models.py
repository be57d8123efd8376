"""Networks, planners and their vocabularies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from fuzz.target import Target
from recast.actors.grounded_segmenter import GroundedSamSegmenter
from recast.planning.gtrs import GtrsPlanner, load_gtrs, new_model, save_gtrs
from recast.planning.gtrs.scores import read_vocabulary
from recast.trellis.generate import ImageTo3D
from support.tiny_gtrs import TINY, VIEWS, fan
from support.tiny_networks import write_tiny_networks
from support.trellis_folder import write_golden_model


def _write_gtrs(folder: Path) -> None:
    model = new_model(TINY, torch.Generator().manual_seed(0))
    save_gtrs(folder / "planner", GtrsPlanner(model, fan(12), VIEWS))


TARGETS = (
    Target(
        "vocabulary",
        lambda f: np.save(f / "v.npy", fan(12)),
        lambda f, out: read_vocabulary(f / "v.npy"),
        weight=12.0,
    ),
    Target("gtrs", _write_gtrs, lambda f, out: load_gtrs(f / "planner"), weight=3.0),
    Target(
        "gtrs-record",
        _write_gtrs,
        lambda f, out: load_gtrs(f / "planner"),
        files=("*.json",),
        weight=3.0,
    ),
    Target(
        "trellis",
        lambda f: write_golden_model(f / "model"),
        lambda f, out: ImageTo3D.load(f / "model"),
        weight=0.3,
    ),
    Target(
        "trellis-record",
        lambda f: write_golden_model(f / "model"),
        lambda f, out: ImageTo3D.load(f / "model"),
        files=("*.json",),
        weight=0.7,
    ),
    Target(
        "segmenter",
        lambda f: write_tiny_networks(f / "networks"),
        lambda f, out: GroundedSamSegmenter(f / "networks"),
        files=("*.json", "*.safetensors"),
        weight=0.5,
    ),
)
