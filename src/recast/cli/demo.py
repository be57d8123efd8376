"""`recast demo`: everything at once, on a made-up drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Demo:
    """Make a drive, reconstruct it, replace a vehicle, run it in closed loop against the truth.

    Needs nothing but this program. What an earlier demo left in the folder is used again.
    """

    out: Path | None = None
    """Folder for the log and the run. Default: runs/demo, with --quick runs/demo-quick."""
    quick: bool = False
    """One short motion at low resolution, in less than two minutes."""
    scene: str = "urban-straight"
    """Synthetic scene; `recast log synth --help` lists them."""
    seed: int = 1
    """Seed of everything random, the drive itself included."""
    generator: str = "auto"
    """What makes the vehicle: auto (the better one of template and recast-mini for
    this vehicle), recast-mini (the image-to-3D model of the package), template, an
    installed generator's name, a model folder, the path of a PLY, GLB or OBJ, or
    library:FOLDER."""
    planner: str | None = None
    """Planner under test, as for recast run. Default: gtrs-mini (the package's, which looks at
    three cameras); with --quick, which has one camera, idm-follower."""
    threads: int = 0
    """CPU threads, 0 for all."""

    def __call__(self) -> None:
        """Run the command."""
        from rich.console import Console

        from recast.pipeline.demo import FULL, QUICK, demo

        out = self.out or Path("runs/demo-quick" if self.quick else "runs/demo")
        size = QUICK if self.quick else FULL
        demo(
            out, self.scene, self.seed, size, self.threads, Console(), self.generator, self.planner
        )
