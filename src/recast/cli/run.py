"""`recast run` and `recast demo`: the whole job, on a log or on a made-up drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.output import JSON, console_for, print_json

Names = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True)
class Run:
    """Do everything from a log to a report: scene, actor, closed-loop rollouts, metrics.

    Scenes, actors and rollouts are kept in a store, where this run and others find them again.
    """

    log: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="PATH")]]
    """Log folder, or its address in object storage (s3://...)."""
    track: Annotated[str, shared.required(shared.TRACK_HELP)]
    out: Path
    """Run folder; the same command resumes a run that was stopped."""
    motion: Annotated[Names, shared.option(shared.MOTION_HELP, "cut-in and stationary")] = ()
    arm: Annotated[Names, shared.ARM] = ()
    config: Annotated[Path | None, shared.option(shared.CONFIG_HELP, metavar="PATH")] = None
    planner: Annotated[Names, shared.PLANNER] = ()
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    generator: Annotated[str | None, shared.GENERATOR] = None
    axes: Annotated[str | None, shared.AXES] = None
    refine: Annotated[bool | None, shared.REFINE] = None
    segmenter: Annotated[str | None, shared.SEGMENTER] = None
    views: Annotated[int | None, shared.VIEWS] = None
    scene: Annotated[Path | None, shared.SCENE] = None
    store: Annotated[
        str | None, shared.option(shared.STORE_HELP, "store, beside the run folder", metavar="PATH")
    ] = None
    preset: Annotated[Literal["streetgs", "omnire"] | None, shared.PRESET] = None
    scene_config: Annotated[Path | None, shared.SCENE_CONFIG] = None
    cameras: Annotated[tuple[str, ...] | None, shared.CAMERAS] = None
    scale: Annotated[float | None, shared.option(shared.SCALE_HELP, "0.5", metavar="FLOAT")] = None
    iterations: Annotated[
        int | None, shared.option(shared.ITERATIONS_HELP, "2800", metavar="INT")
    ] = None
    steps: Annotated[int | None, shared.STEPS] = None
    seed: Annotated[int | None, shared.SEED] = None
    threads: Annotated[int | None, shared.THREADS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from recast.pipeline.config import resolve_config
        from recast.pipeline.run import run

        config = resolve_config(
            track=self.track,
            motions=self.motion,
            config_file=self.config,
            scene_config_file=self.scene_config,
            run_options=shared.run_options(self),
            scene_options=shared.scene_options(self),
        )
        run(self.log, self.out, config, console_for(self.json), self.store)
        if self.json:
            from recast.cli.rows.grids import run_rows

            print_json(run_rows(self.out))


@dataclass(frozen=True)
class Demo:
    """Make a synthetic drive, reconstruct it, replace a vehicle, and compare closed-loop rollouts
    with the ground truth.

    The demo needs no data. It reuses the results of an earlier demo in the same folder.
    """

    out: Annotated[
        Path | None,
        shared.option(
            "Folder of the log and the run.",
            "runs/demo, with --quick runs/demo-quick",
            metavar="PATH",
        ),
    ] = None
    quick: bool = False
    """Run one short motion at low resolution (about two minutes on two cores)."""
    scene: str = "urban-straight"
    """Synthetic scene; `recast log synth --help` lists the names."""
    seed: Annotated[int, shared.option(f"{shared.SEED_HELP} The drive depends on it, too.")] = 1
    generator: Annotated[str | None, shared.GENERATOR] = None
    planner: Annotated[
        str | None,
        shared.option(
            shared.PLANNER_HELP,
            "gtrs-mini; with --quick, which has one camera, idm-follower",
            metavar="NAME",
        ),
    ] = None
    threads: Annotated[int | None, shared.THREADS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        """Run the command."""
        from recast.actors import DEFAULT_GENERATOR
        from recast.pipeline.run import FULL, QUICK, RUN_FOLDER, demo

        out = self.out or Path("runs/demo-quick" if self.quick else "runs/demo")
        demo(
            out,
            self.scene,
            self.seed,
            QUICK if self.quick else FULL,
            self.threads or 0,
            console_for(self.json),
            self.generator or DEFAULT_GENERATOR,
            self.planner,
        )
        if self.json:
            from recast.cli.rows.grids import run_rows

            print_json(run_rows(out / RUN_FOLDER))
