"""`recast run`, `recast demo`, `recast report`, `recast view`: the whole job, and looks at it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json
from recast.core import diagnostics
from recast.core.errors import InputError


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
    motion: Annotated[shared.Names, shared.option(shared.MOTION_HELP, "cut-in and stationary")] = ()
    arm: Annotated[shared.Names, shared.ARM] = ()
    config: Annotated[Path | None, shared.option(shared.CONFIG_HELP)] = None
    planner: Annotated[shared.Names, shared.PLANNER] = ()
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    restorer: Annotated[str | None, shared.RESTORER] = None
    metric: Annotated[shared.Names, shared.METRIC] = ()
    generator: Annotated[str | None, shared.GENERATOR] = None
    axes: Annotated[str | None, shared.AXES] = None
    refine: shared.Refine = None
    segmenter: Annotated[str | None, shared.SEGMENTER] = None
    views: Annotated[int | None, shared.VIEWS] = None
    scene: Annotated[Path | None, shared.SCENE] = None
    store: Annotated[
        str | None, shared.option(shared.STORE_HELP, "store, beside the run folder", metavar="PATH")
    ] = None
    preset: Annotated[Literal["streetgs", "omnire"] | None, shared.PRESET] = None
    scene_config: Annotated[Path | None, shared.SCENE_CONFIG] = None
    cameras: Annotated[tuple[str, ...] | None, shared.CAMERAS] = None
    scale: Annotated[float | None, shared.option(shared.SCALE_HELP, "0.5")] = None
    iterations: Annotated[int | None, shared.option(shared.ITERATIONS_HELP, "2800")] = None
    complete: Annotated[shared.Names, shared.COMPLETE] = ()
    traffic: shared.Traffic = None
    steps: Annotated[int | None, shared.STEPS] = None
    seed: Annotated[int | None, shared.SEED] = None
    threads: Annotated[int | None, shared.THREADS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.runs.config import resolve_config
        from recast.runs.run import run

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
            from recast.cli.rows.results import run_rows

            print_json(run_rows(self.out))


@dataclass(frozen=True)
class Demo:
    """Make a synthetic drive, reconstruct it, replace a vehicle, and compare closed-loop rollouts
    with the ground truth.

    The demo needs no data. It reuses the results of an earlier demo in the same folder.
    """

    out: Annotated[
        Path | None,
        shared.option("Folder of the log and the run.", "runs/demo, with --quick runs/demo-quick"),
    ] = None
    quick: bool = False
    """Run one short motion at low resolution (about a minute and a half on two cores)."""
    scene: str = "urban-straight"
    """Synthetic scene; `recast log synth --help` lists the names."""
    seed: Annotated[int, shared.option(f"{shared.SEED_HELP} The drive depends on it, too.")] = 1
    generator: Annotated[str | None, shared.GENERATOR] = None
    planner: Annotated[
        str | None,
        shared.option(
            shared.PLANNER_HELP,
            "gtrs-mini",
            metavar="NAME",
        ),
    ] = None
    threads: Annotated[int | None, shared.THREADS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.actors import DEFAULT_GENERATOR
        from recast.runs.run import FULL, QUICK, RUN_FOLDER, demo

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
            from recast.cli.rows.results import run_rows

            print_json(run_rows(out / RUN_FOLDER))


@dataclass(frozen=True)
class Report:
    """Write the report of a run, or compare several runs.

    The result is one folder with index.html and everything that the page shows. It opens from disk.
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], shared.several("RUN...")]
    """Run folder made by `recast run`; with --compare two or more of them."""
    compare: bool = False
    """Write one page that sets the runs side by side. Differences are to the first run."""
    out: Annotated[Path | None, shared.several("PATH", "default: RUN/report")] = None
    """Folder to write to; required with --compare."""

    def __call__(self) -> None:
        if not self.compare and len(self.runs) != 1:
            raise InputError(
                "RUNS",
                "run folder",
                f"{len(self.runs)} are given",
                "name one run, or add --compare to set several side by side",
            )
        if self.compare and self.out is None:
            raise InputError(
                "--out", "folder", "is missing", "name the folder for the page of --compare"
            )
        from rich.console import Console

        from recast.runs.report import compare_runs, report_run

        if self.compare:
            assert self.out is not None
            page = compare_runs(self.runs, self.out)
        else:
            page = report_run(self.runs[0], self.out)
        Console().print(f"wrote {page}", markup=False)


@dataclass(frozen=True)
class ViewCommand:
    """Show logs, scenes, actors and rollouts in three dimensions, in a browser."""

    what: Annotated[tyro.conf.Positional[tuple[Path, ...]], shared.several("WHAT...")]
    """A run folder; or rollout folders of one run; or a log with scenes, actors and rollouts of
    it; or scenes or actors alone."""
    host: str = "127.0.0.1"
    """Address to listen on. The default can be reached from this machine only; 0.0.0.0 lets
    everybody in your network look and run rollouts."""
    port: int = 8080
    """TCP port; the next free one if it is in use."""
    allow_host: Annotated[shared.Names, shared.ALLOW_HOST] = ()
    max_gaussians: int = 300_000
    """Maximum number of Gaussians that browsers get; the most important ones are kept."""
    out: Path = Path("scenarios")
    """Folder for the scenario files that are saved from the page."""
    replay: Annotated[Path | None, shared.several("PATH", "optional")] = None
    """Write this HTML file, which plays without a server, instead of opening a page."""
    replay_mb: float = 15.0
    """Maximum size of the replay in MB; fewer Gaussians make it smaller."""
    scenario: Annotated[str | None, shared.several("NAME", "default: the first one")] = None
    """Scenario of the replay, such as cut-in-a."""

    def __call__(self) -> None:
        from rich.console import Console

        from recast.runs.view import replay_what, require_limits, serve_what, view_inputs

        require_limits(self.what, self.port, self.max_gaussians, self.replay, self.replay_mb)
        console, inputs = Console(), view_inputs(self.what)
        if self.replay is not None:
            replay_what(
                inputs, self.replay, self.replay_mb, self.max_gaussians, self.scenario, console
            )
        else:
            diagnostics.show_warnings()
            serve_what(
                inputs, self.host, self.port, self.max_gaussians, self.out, console, self.allow_host
            )
