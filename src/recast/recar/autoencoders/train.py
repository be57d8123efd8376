"""`recast recar autoencoder`: one part of the recipe, with what it shows."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Literal

from rich.console import Console

from recast.errors import InputError
from recast.recar.autoencoders.recipe import (
    REPORT_FILE,
    Report,
    train_image,
    train_latent,
    train_structure,
)
from recast.trellis.checkpoints import SMALL
from recast.trellis.checkpoints.load import load_model
from recast.trellis.checkpoints.model_files import model_files
from recast.trellis.checkpoints.roles import STRUCTURE_ENCODER
from recast.trellis.models import SparseStructureEncoder

Part = Literal["structure", "latent", "image"]
STEPS: dict[Part, int] = {"structure": 1500, "latent": 8000, "image": 3000}
"""Of the shipped model."""


def train_part(
    part: Part, assets: Path, out: Path, console: Console, *,
    structure: Path | None, steps: int | None, seed: int,
) -> Report:  # fmt: skip
    """Train one part, showing its losses, then what it reaches on held-out assets.

    Raises:
        InputError: no assets, a folder of another training, a number of steps below one, or for
            the image encoder no trained structure encoder.
    """
    if steps is not None and steps < 1:
        raise InputError("--steps", "value", f"is {steps}", "give 1 or more")
    steps = steps or STEPS[part]
    start = time.perf_counter()

    def watch(step: int, logs: dict[str, float]) -> None:
        values = "  ".join(f"{name} {value:.4g}" for name, value in logs.items())
        minutes = (time.perf_counter() - start) / 60
        console.print(f"{step}/{steps}  {minutes:.1f} min  {values}", highlight=False)

    if part == "structure":
        report = train_structure(assets, out, steps, seed, watch)
    elif part == "latent":
        report = train_latent(assets, out, steps, seed, watch)
    else:
        if structure is None:
            raise InputError(
                "--structure", "folder", "is missing",
                "train the structure autoencoder first and name its folder",
            )  # fmt: skip
        report = train_image(assets, structure_encoder(structure), out, steps, seed, watch)
    for name, value in report.items():
        console.print(f"{name}: {value}", highlight=False)
    console.print(f"wrote {out / REPORT_FILE}", markup=False)
    return report


def structure_encoder(folder: Path) -> SparseStructureEncoder:
    """The encoder of a trained structure autoencoder, in evaluation mode.

    Raises:
        InputError: it was not trained to its end, or its files are at fault.
    """
    files = model_files(folder, SMALL.record, STRUCTURE_ENCODER)
    model = load_model(files)
    assert isinstance(model, SparseStructureEncoder)  # the role's class was checked
    return model.eval()
