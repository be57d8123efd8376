"""`recast bench`: whole experiments as one command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json
from recast.core.errors import InputError

if TYPE_CHECKING:
    from recast.studies import BenchSettings

Lists = tyro.conf.UseAppendAction[tuple[tuple[str, ...], ...]]


def _motions(default: str) -> Any:
    many = "NAME [NAME ...]"
    return shared.option(shared.MOTIONS_HELP, default, metavar=many, aliases=("--motions",))


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Options of scenes, arms and motions."""

    scenes: tuple[str, ...]
    """Synthetic scenes (NAME or NAME:SEED; the word synthetic for all nine), or log folders with
    the track to control (LOG:TRACK)."""
    out: Path
    """Folder of the results; the same command resumes what was stopped."""
    arm: Annotated[
        shared.Names,
        shared.option(
            f"{shared.ARM_HELP} Also assets:DIR: vehicles in DIR/SCENE.ply, .glb, .gltf, .obj, "
            ".spz or .usda.",
            shared.ARM_DEFAULT,
        ),
    ] = ()
    track: Annotated[
        str | None, shared.option(f"{shared.TRACK_HELP} For log folders named without one.")
    ] = None
    scene: Annotated[Path | None, shared.SCENE] = None
    store: Annotated[
        str | None,
        shared.option(shared.STORE_HELP, "store, beside --out", metavar="PATH"),
    ] = None
    workers: Annotated[int, shared.WORKERS] = 1
    ray: Annotated[str | None, shared.RAY] = None
    config: Annotated[
        Path | None,
        shared.option(f"{shared.CONFIG_HELP} The bench.json of another grid works, too."),
    ] = None
    quick: bool = False
    """Use a small grid: drives of 8 s, one camera of 192x128 pixels, 300 training steps, rollouts
    of 40 steps. Other options override it."""
    seconds: Annotated[
        float | None, shared.option("Duration of synthetic drives in seconds, at most 20.", "20")
    ] = None
    width: Annotated[int | None, shared.option("Width of synthetic images in pixels.", "480")] = (
        None
    )
    height: Annotated[int | None, shared.option("Height of synthetic images in pixels.", "320")] = (
        None
    )
    generator: Annotated[str | None, shared.GENERATOR] = None
    axes: Annotated[str | None, shared.AXES] = None
    refine: shared.Refine = None
    segmenter: Annotated[str | None, shared.SEGMENTER] = None
    views: Annotated[int | None, shared.VIEWS] = None
    preset: Annotated[Literal["streetgs", "omnire"] | None, shared.PRESET] = None
    scene_config: Annotated[Path | None, shared.SCENE_CONFIG] = None
    cameras: Annotated[tuple[str, ...] | None, shared.CAMERAS] = None
    scale: Annotated[float | None, shared.option(shared.SCALE_HELP, "1")] = None
    iterations: Annotated[int | None, shared.option(shared.ITERATIONS_HELP, "2800")] = None
    traffic: shared.Traffic = None
    steps: Annotated[int | None, shared.STEPS] = None
    seed: Annotated[
        int | None,
        shared.option(f"{shared.SEED_HELP} Synthetic scenes named without a seed use it.", "0"),
    ] = None
    samples: Annotated[int, shared.SAMPLES] = 200_000
    json: Annotated[bool, JSON] = False

    def _settings(self, motions: Sequence[str], **options: Any) -> BenchSettings:
        from recast.studies import resolve_bench

        return resolve_bench(
            words=self.scenes,
            track=self.track,
            motions=motions,
            quick=self.quick,
            config_file=self.config,
            scene_config_file=self.scene_config,
            samples=self.samples,
            drive_options={"seconds": self.seconds, "width": self.width, "height": self.height},
            run_options={**shared.run_options(self), **options},
            scene_options=shared.scene_options(self),
        )


@dataclass(frozen=True, kw_only=True)
class ClosedLoop(_Grid):
    """Run the paper's closed-loop protocol (scenes x motions x arms x planners) and print its
    table.

    Finished rollouts are kept, so the same command resumes a grid that was stopped or killed.
    """

    planner: Annotated[shared.Names, shared.PLANNER] = ()
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    motion: Annotated[Lists, _motions("cut-in, oncoming and stationary")] = ()
    restorer: Annotated[str | None, shared.RESTORER] = None
    metric: Annotated[shared.Names, shared.METRIC] = ()
    films: bool = False
    """Render every step of all cameras and write videos, not only what the planner sees."""
    plan_timeout: Annotated[
        float | None,
        shared.option("Time limit of one plan in seconds; a slower plan fails its rollout."),
    ] = None
    retry_failures: bool = False
    """Run rollouts again that failed before."""

    def __call__(self) -> None:
        from recast.studies import run_closed_loop

        settings = self._settings(tuple(name for names in self.motion for name in names))
        results = run_closed_loop(
            settings,
            self.out,
            console_for(self.json),
            workers=self.workers,
            ray=self.ray,
            retry_failures=self.retry_failures,
            store=self.store,
        )
        if self.json:
            from recast.cli.rows.results import grid_rows

            print_json(grid_rows(results))


@dataclass(frozen=True, kw_only=True)
class Search(_Grid):
    """Find where in a range of settings a planner begins to fail: the boundary, its interval, the
    mildest failure and the hardest success.

    Trials are kept in a database, so the same command resumes a study that was stopped or killed,
    and several processes and machines work on one.
    """

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], shared.several("LOG...")]
    """Log folders with the track to control (LOG:TRACK, or LOG and --track), or synthetic scenes
    (NAME or NAME:SEED)."""
    motion: Annotated[
        shared.Names,
        shared.option("Motion whose settings are varied. May be repeated.", "cut-in-a"),
    ] = ()
    over: Annotated[
        shared.Names,
        shared.option(
            "Setting to vary, with its range or its values: gap=2:40 or delay=0,1,2. A range may "
            "say how often its values occur: gap=2:40~lognormal:12,0.5. seed=0,1,2 drives each "
            "point several times. May be repeated; the boundary is told along the first range.",
            "gap=2:40",
            metavar="SETTING=LOW:HIGH",
        ),
    ] = ()
    set: Annotated[
        shared.Names,
        shared.option(
            "Value of another setting. May be repeated.",
            "those of the motion",
            metavar="SETTING=VALUE",
        ),
    ] = ()
    planner: Annotated[shared.Names, shared.PLANNER] = ()
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    restorer: Annotated[str | None, shared.RESTORER] = None
    metric: Annotated[shared.Names, shared.METRIC] = ()
    plan_timeout: Annotated[
        float | None,
        shared.option("Time limit of one plan in seconds; a slower plan fails its rollout."),
    ] = None
    objective: str = "at-fault"
    """What counts as a failure: at-fault (a contact that the ego is to blame for), collision (any),
    or a threshold of a measure, such as 'ttc<1', 'distance<0.5' or 'braking>4'."""
    design: Literal["boundary", "bisect", "grid", "sobol"] = "boundary"
    """How trials are chosen: boundary (a Gaussian process that seeks where the verdict changes),
    bisect (along one range), grid or sobol (evenly)."""
    trials: int = 60
    """Number of trials for each log, motion, planner and arm."""
    database: Annotated[
        str | None,
        shared.option(
            "SQLite file or address of the database (postgresql://...).", "search.db in --out"
        ),
    ] = None
    study: Annotated[
        str | None, shared.option("Name of the study in the database.", "name of --out")
    ] = None
    unfair: bool = False
    """Count scenarios, too, that no driver could have mastered."""
    reports: bool = False
    """Drive the mildest failures and the hardest successes again, with films and a report."""
    compare: Annotated[
        Path | None,
        shared.option("Folder of an earlier study: tell which failures are new, and which gone."),
    ] = None
    most_new: Annotated[
        float | None,
        shared.option("With --compare: exit with code 1 if a larger share of trials fails anew."),
    ] = None

    def __call__(self) -> int:
        from recast.studies.boundary import answers_of, compare, search_rows
        from recast.studies.search import parse_fixed, resolve_search, run_search
        from recast.studies.search_page import (
            print_comparison,
            print_search,
            report_examples,
            write_page,
            write_search,
        )

        if self.most_new is not None and self.compare is None:
            mend = "name the earlier study, or leave --most-new out"
            raise InputError("--compare", "folder", "is missing", mend)

        settings = resolve_search(
            lambda motions: self._settings(motions, films=False),
            motions=self.motion,
            over=self.over,
            fixed=parse_fixed(self.set),
            objective=self.objective,
            design=self.design,
            trials=self.trials,
            seed=self.seed or 0,
        )
        console = console_for(self.json)
        results = run_search(
            settings,
            self.out,
            console,
            workers=self.workers,
            ray=self.ray,
            store=self.store,
            database=self.database,
            study=self.study,
        )
        answers = answers_of(results, fair_only=not self.unfair)
        write_search(answers, self.out)
        if self.reports:
            report_examples(answers, self.out, console, self.store)
            write_page(answers, self.out)
        print_search(answers, console)
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            print_json(search_rows(answers))
        if len(results.failed) == len(settings.bench.scenes):
            return 2
        if self.compare is None:
            return 0
        against = compare(answers, self.compare)
        print_comparison(against, settings.design, console)
        share = len(against.new) / against.common
        return int(self.most_new is not None and share > self.most_new)


@dataclass(frozen=True, kw_only=True)
class SceneLevel(_Grid):
    """Score how real and how complete the images of each arm look: Frechet distances, CLIP, VQA
    and LPIPS scores of whole frames and of vehicle crops.

    pdm-closed drives each scene and motion once, and every arm renders the same states. A score
    without its weights has no column.
    """

    motion: Annotated[Lists, _motions("cut-in, oncoming, stationary and advancing")] = ()
    inception: Annotated[Path | None, shared.INCEPTION] = None
    clip: Annotated[Path | None, shared.CLIP] = None
    lpips_weights: Annotated[Path | None, shared.LPIPS_WEIGHTS] = None
    vqa: Annotated[
        str | None,
        shared.option(
            "VQA scorer: clip-flant5-xl (recast weights) or its folder, t2v_metrics:NAME, or "
            "package.module:attribute.",
            "no VQA score",
            metavar="NAME",
        ),
    ] = None
    device: Annotated[str, shared.required("Device of the networks: cpu, cuda or cuda:1.")] = "cpu"
    every: int = 5
    """Interval in steps between the images of a rollout that are scored."""
    least_px: float = 32.0
    """Minimum length in pixels of the shorter side of the vehicle's box in a scored image."""
    crop: Literal["boxed", "masked"] = "boxed"
    """Vehicle crops: boxed keeps the background, masked removes everything outside the outline of
    the box."""
    references: int = 16
    """Maximum number of logged crops of a scene that LPIPS and the CLIP image score compare
    with."""
    frechet_samples: int = 2000
    """Number of bootstrap samples of the intervals of Frechet distances."""

    def __call__(self) -> None:
        from recast.metrics.scene_level_images import FrameRule
        from recast.studies.scene_level_study import LevelSettings, run_scene_level
        from recast.studies.scene_level_tasks import LEVEL_MOTIONS, NetworkFiles
        from recast.weights import located

        networks = NetworkFiles(
            located("--inception", self.inception),
            located("--clip", self.clip),
            located("--lpips-weights", self.lpips_weights),
            self.vqa,
            self.device,
        )
        motions = tuple(name for names in self.motion for name in names)
        settings = LevelSettings(
            grid=self._settings(motions or LEVEL_MOTIONS, films=False),
            rule=FrameRule(every=self.every, least_px=self.least_px),
            crop=self.crop,
            most_references=self.references,
            networks=networks,
            hashes=networks.hashes(),
            frechet_samples=self.frechet_samples,
        )
        lines = run_scene_level(
            settings,
            self.out,
            console_for(self.json),
            workers=self.workers,
            ray=self.ray,
            store=self.store,
        )
        if self.json:
            from recast.cli.rows.results import level_rows

            print_json(level_rows(lines))


@dataclass(frozen=True, kw_only=True)
class Trust:
    """Calibrate how far to trust the verdict of a rollout, on finished grids with an oracle arm.

    Prints, with each scene judged by the others, how often verdicts of each trust agree with the
    truth, the area under the ROC curve and the Brier score.
    """

    grids: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], shared.several("GRID...", "required, or --validate")
    ] = ()
    """Grids of `recast bench closed-loop` with an oracle arm, two scenes or more in all."""
    out: Annotated[
        Path | None,
        shared.option("File of the calibration (JSON); its diagrams (SVG) are written beside it."),
    ] = None
    validate: Annotated[
        tuple[Path, ...],
        shared.option(
            "Other grids with an oracle arm that the calibration is applied to.",
            metavar="GRID [GRID ...]",
        ),
    ] = ()
    calibration: Annotated[
        Path | None, shared.option("Calibration to validate, if no grid is given.", "the package's")
    ] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.studies.trust import run_trust

        found = run_trust(
            self.grids, self.validate, self.out, console_for(self.json), self.calibration
        )
        if self.json:
            from recast.cli.rows.results import trust_rows

            print_json(trust_rows(found))


Bench = shared.group(
    "bench",
    "Run a whole experiment of the paper over scenes, motions and arms, or calibrate on one.",
    {"closed-loop": ClosedLoop, "scene-level": SceneLevel, "trust": Trust},
)
