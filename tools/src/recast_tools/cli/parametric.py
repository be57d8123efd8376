"""`recast recar designs | parametric`: the data and the training of the parametric model."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from recast.cli import shared
from recast.cli.shared import console_for


@dataclass(frozen=True)
class RecarDesigns:
    """Make photographs of random designs to train the parametric model on."""

    shards: int
    """Number of shards of 80 vehicles with 3 photographs each; a folder of the same seed grows."""
    out: Path
    """Folder of the shards; the same command resumes."""
    seed: Annotated[int, shared.SEED] = 0
    workers: Annotated[int, shared.WORKERS] = 1

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast_tools.parametric.dataset import DesignsRecord, make_designs

        console = console_for(False)
        with ProgressBar("shards", console) as progress:
            record = DesignsRecord(seed=self.seed)
            make_designs(self.out, self.shards, record, workers=self.workers, progress=progress)
        console.print(f"wrote {self.out}: {self.shards} shards", markup=False)


@dataclass(frozen=True)
class TrainParametric:
    """Train the parametric model, and measure it on the held-out designs.

    With `torchrun --nproc-per-node N --no-python recast recar parametric ...`, N processes share
    the work.
    """

    designs: Path
    """Folder of `recast recar designs`."""
    out: Path
    """Folder of the training; the same command resumes. Writes OUT/model.safetensors."""
    steps: Annotated[
        int | None, shared.option("Number of optimiser steps.", "the shipped model's")
    ] = None
    seed: Annotated[int, shared.SEED] = 0
    threads: int = 1
    """Number of CPU threads."""

    def __call__(self) -> None:
        from recast.core.workers import use_threads
        from recast.training.loop import Processes
        from recast_tools.parametric.training import REPORT_FILE, STEPS, train_parametric

        use_threads(self.threads)
        console = console_for(False)
        start, steps = time.perf_counter(), self.steps or STEPS

        def watch(step: int, logs: dict[str, float]) -> None:
            values = "  ".join(f"{name} {value:.4g}" for name, value in logs.items())
            minutes = (time.perf_counter() - start) / 60
            console.print(f"{step}/{steps}  {minutes:.1f} min  {values}", highlight=False)

        processes = Processes.started()
        report = train_parametric(
            self.designs, self.out, steps, self.seed, watch, processes=processes
        )
        if not processes.first:
            return
        for name, value in report.items():
            console.print(f"{name}: {value}", highlight=False)
        console.print(f"wrote {self.out / REPORT_FILE}", markup=False)
