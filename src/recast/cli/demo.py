"""`recast demo`: everything at once, on a made-up drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json


@dataclass(frozen=True)
class Demo:
    """Make a synthetic drive, reconstruct it, replace a vehicle, and compare closed-loop rollouts
    with the ground truth.

    The demo needs no data. It reuses the results of an earlier demo in the same folder.
    """

    out: Annotated[
        Path | None,
        shared.option(
            "Folder of the log and the run.", "runs/demo, with --quick runs/demo-quick",
            metavar="PATH",
        ),
    ] = None  # fmt: skip
    quick: bool = False
    """Run one short motion at low resolution (about two minutes on two cores)."""
    scene: str = "urban-straight"
    """Synthetic scene; `recast log synth --help` lists the names."""
    seed: Annotated[int, shared.option(f"{shared.SEED_HELP} The drive depends on it, too.")] = 1
    generator: Annotated[str | None, shared.GENERATOR] = None
    planner: Annotated[
        str | None,
        shared.option(
            shared.PLANNER_HELP, "gtrs-mini; with --quick, which has one camera, idm-follower",
            metavar="NAME",
        ),
    ] = None  # fmt: skip
    threads: Annotated[int | None, shared.THREADS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from recast.actors import DEFAULT_GENERATOR
        from recast.pipeline.demo import FULL, QUICK, RUN_FOLDER, demo

        out = self.out or Path("runs/demo-quick" if self.quick else "runs/demo")
        demo(
            out, self.scene, self.seed, QUICK if self.quick else FULL, self.threads or 0,
            console_for(self.json), self.generator or DEFAULT_GENERATOR, self.planner,
        )  # fmt: skip
        if self.json:
            from recast.cli.rows.grids import run_rows

            print_json(run_rows(out / RUN_FOLDER))
