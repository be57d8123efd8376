"""`recast eval`: judge parts against pictures that they have not seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Eval:
    """Make vehicles from one picture each and compare them with reserved ones."""

    # tyro makes no subcommand of a single choice
    part: Annotated[tyro.conf.Positional[Literal["actor"]], tyro.conf.arg(metavar="actor")]
    """What is judged."""
    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """What makes the vehicles: template, an installed generator, a PLY, or a folder of a model."""
    set: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SET")]
    """Folder of real crops (ID/input_views, ID/reserved_views), or a vehicle set."""
    out: Path
    """Folder to write metrics.json and a picture of every vehicle to; must not exist."""
    seed: int = 0
    """Seed of everything random."""
    limit: int | None = None
    """Judge only this many vehicles, the first by id; all where not given."""
    lpips_weights: Path | None = None
    """AlexNet or VGG-16 weights as torchvision saves them, for LPIPS."""
    clip: Path | None = None
    """Folder of a CLIP model, for the image similarity."""
    dino: Path | None = None
    """Folder of a DINOv2 model, for the feature distance."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console
        from rich.progress import Progress

        from recast.evaluation.perceptual import load_distances
        from recast.pipeline.actor import generator_of
        from recast.pipeline.evaluate_actor import evaluate_actors, evaluation_table

        distances = load_distances(self.lpips_weights, self.clip, self.dino)
        generator = generator_of(self.model)
        console = Console()
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("vehicles", total=None)
            evaluation = evaluate_actors(
                generator,
                self.set,
                self.out,
                seed=self.seed,
                limit=self.limit,
                distances=distances,
                progress=lambda done, of: progress.update(task, completed=done, total=of),
            )
        console.print(evaluation_table(evaluation))
        for vehicle, reason in evaluation.failures.items():
            console.print(f"not made: {vehicle}: {reason}", markup=False)
        console.print(f"wrote {self.out}", markup=False)
