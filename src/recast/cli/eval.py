"""`recast eval`: judge parts against images that they have not seen."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from recast.cli import shared
from recast.cli.shared import JSON, console_for, print_json

if TYPE_CHECKING:
    from recast.recar.perturb import PerturbationConfig


PERTURBED = shared.option(
    "Perturbation file for perturbed input images, or the word default.",
    "clean images only",
    metavar="PATH",
)


@dataclass(frozen=True)
class EvalPhotographs:
    """Make vehicles from one or several images and compare them with photographs that were
    reserved: parts, paint, sharpness, outline and pixels."""

    set: Annotated[tyro.conf.Positional[tuple[Path, ...]], shared.several("SET...")]
    """Folders of real crops (ID/input_views, ID/reserved_views) or vehicle sets, of which the
    held-out vehicles are used."""
    out: Path
    """New folder for metrics.json, and a sheet and the renders of every vehicle."""
    model: Annotated[
        shared.Names,
        shared.option(
            "NAME=WHAT or WHAT: template, an installed generator, package.module:attribute, a "
            "vehicle file or a model folder; or the renders of an earlier run (views:OUT/NAME). "
            "May be repeated; the others are compared with the first.",
            "auto",
        ),
    ] = ()
    seed: Annotated[int, shared.SEED] = 0
    limit: Annotated[int | None, shared.LIMIT] = None
    views: Annotated[int, shared.VIEWS] = 1
    lpips_weights: Annotated[Path | None, shared.LPIPS_WEIGHTS] = None
    clip: Annotated[Path | None, shared.CLIP] = None
    dino: Annotated[Path | None, shared.DINO] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.metrics.perceptual import load_distances
        from recast.studies.generation.rows import parse_models
        from recast.studies.photographs import evaluate_photographs, photographs_table
        from recast.weights import located

        distances = load_distances(
            located("--lpips-weights", self.lpips_weights),
            located("--clip", self.clip),
            located("--dino", self.dino),
        )
        named = [text if "=" in text else f"{_label(text)}={text}" for text in self.model]
        console = console_for(self.json)
        with ProgressBar("vehicles", console) as progress:
            evaluation = evaluate_photographs(
                {name: one.source for name, one in parse_models(named or ["auto=auto"]).items()},
                self.set,
                self.out,
                seed=self.seed,
                limit=self.limit,
                views=self.views,
                distances=distances,
                progress=progress,
            )
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            from recast.cli.rows.results import photograph_rows

            print_json(photograph_rows(evaluation))
            return
        console.print(photographs_table(evaluation))
        for one in evaluation.generators:
            told = f"{one.name}: {one.undecided} part checks are not decided by the photographs"
            console.print(told, markup=False)
            for vehicle, reason in one.failures.items():
                console.print(f"not made by {one.name}: {vehicle}: {reason}", markup=False)


def _label(source: str) -> str:
    """Name of a generator in tables and folders: what it is called without the folders around."""
    last = re.split(r"[/:]", source.rstrip("/"))[-1]
    return re.sub(r"[^A-Za-z0-9._-]", "-", last).lstrip("._-")[:40] or "model"


@dataclass(frozen=True)
class EvalActor:
    """Make and refine the vehicles of a log's tracks and compare them with the log's held-out
    images, or with images of a hidden side."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """Generator of the vehicles: auto, template, an installed generator, a vehicle file or a model
    folder."""
    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log folder."""
    out: Path
    """New folder for metrics.json, and a folder of every track."""
    scene: Annotated[Path, shared.option("Scene folder of the log, with models of the tracks.")]
    track: Annotated[
        shared.Names, shared.option("Id of a track of the log to evaluate. May be repeated.")
    ] = ()
    hide: Annotated[
        float | None,
        shared.option(
            "Hide the images of one side: those that look at the vehicle from more degrees away "
            "than this from all others, and compare with them. Trains a street without them.",
            "compare with held-out images",
            metavar="DEG",
        ),
    ] = None
    segmenter: Annotated[str, shared.SEGMENTER] = "box-lidar"
    axes: Annotated[str, shared.AXES] = "auto"
    seed: Annotated[int, shared.SEED] = 0
    lpips_weights: Annotated[Path | None, shared.LPIPS_WEIGHTS] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.cli.rows.results import hidden_rows, track_rows
        from recast.core.errors import require_range
        from recast.logs import read_log
        from recast.metrics.perceptual import load_distances
        from recast.reconstruction import read_training_config, require_log_of
        from recast.runs.actor import ActorMakers
        from recast.runs.display import SamplingProgress
        from recast.scene import load_scene
        from recast.studies import logged_vehicles as study
        from recast.weights import located

        if self.hide is not None:
            require_range(1.0, 180.0, hide=self.hide)
        distances = load_distances(located("--lpips-weights", self.lpips_weights), None, None)
        makers = ActorMakers.named(self.model, self.segmenter, self.axes)
        given = read_log(self.log), load_scene(self.scene), read_training_config(self.scene)
        require_log_of(self.scene, given[0])
        console = console_for(self.json)
        with SamplingProgress(console) as progress:
            if self.hide is None:
                results = study.evaluate_tracks(
                    *given, self.track, makers, self.out, self.seed, progress
                )
                table, rows = study.tracks_table(results), track_rows(results)
            else:
                hidden = study.evaluate_hidden(
                    *given,
                    self.track,
                    self.hide,
                    makers,
                    self.out,
                    self.seed,
                    next(iter(distances), None),
                    progress,
                )
                table, rows = study.hidden_table(hidden), hidden_rows(hidden)
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            print_json(rows)
            return
        console.print(table)


@dataclass(frozen=True)
class EvalPlanner:
    """Let a planner plan on the recorded images of drives and compare its plans with what was
    driven."""

    planner: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="PLANNER")]
    """Planner: as for `recast run --planner`."""
    log: Annotated[tyro.conf.Positional[tuple[Path, ...]], shared.several("LOG...")]
    """Log folders."""
    out: Path
    """New folder for metrics.json and a page with the ten moments furthest from what was driven."""
    every: float = 0.5
    """Seconds between the moments of a drive."""
    seed: Annotated[int, shared.SEED] = 0
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.core.errors import require_range
        from recast.logs import read_log
        from recast.planning import make_planner
        from recast.studies.planner_driving import driving_table, evaluate_planner

        require_range(0.1, every=self.every)
        planner = make_planner(self.planner, self.planner_device or "auto")
        logs = [read_log(path) for path in self.log]
        console = console_for(self.json)
        with ProgressBar("drives", console) as progress:
            found = evaluate_planner(
                planner, logs, self.out, every=self.every, seed=self.seed, progress=progress
            )
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            from recast.cli.rows.results import driving_rows

            print_json(driving_rows(found))
            return
        console.print(driving_table(found))


@dataclass(frozen=True)
class EvalPlans:
    """Compare a planner's plans on the images of a reconstruction with those on the recorded ones,
    at the log's own moments."""

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log folder."""
    scene: Annotated[Path, shared.option("Scene folder of the log.")]
    planner: str
    """Planner: as for `recast run --planner`."""
    out: Path
    """New folder for metrics.json and a page with the ten moments of the largest difference."""
    actor: Annotated[
        tuple[Path, ...],
        shared.option("Folder of an actor that replaces its track. May be repeated.", "none"),
    ] = ()
    every: float = 0.5
    """Seconds between the moments of the drive."""
    detector: Annotated[
        str | None,
        shared.option(
            "Detector whose boxes on both images are compared: an installed one, or "
            "package.module:attribute.",
            "none",
        ),
    ] = None
    seed: Annotated[int, shared.SEED] = 0
    planner_device: Annotated[str | None, shared.PLANNER_DEVICE] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.actors import load_actor
        from recast.core.diagnostics import ProgressBar
        from recast.core.errors import require_range
        from recast.core.plugins import DETECTORS
        from recast.logs import read_log
        from recast.planning import make_planner
        from recast.reconstruction.train import (
            CONFIG_FILE,
            read_training_config,
            require_log_of,
        )
        from recast.scene import load_scene
        from recast.studies.planner_driving import agreement_table, evaluate_plans

        require_range(0.1, every=self.every)
        console = console_for(self.json)
        trained = (self.scene / CONFIG_FILE).is_file()  # an imported scene was not
        log = read_log(self.log)
        require_log_of(self.scene, log)
        with ProgressBar("moments", console) as progress:
            found = evaluate_plans(
                make_planner(self.planner, self.planner_device or "auto"),
                log,
                load_scene(self.scene),
                [load_actor(folder) for folder in self.actor],
                self.out,
                training=read_training_config(self.scene) if trained else None,
                every=self.every,
                seed=self.seed,
                detector=None if self.detector is None else DETECTORS.resolve(self.detector),
                progress=progress,
            )
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            from recast.cli.rows.results import agreement_rows

            print_json(agreement_rows(found))
            return
        console.print(agreement_table(found))


@dataclass(frozen=True)
class EvalGeneration:
    """Compare models that make vehicles from one image, on clean and perturbed images."""

    set: Path
    """Vehicle set (its held-out identities are used), or a folder of real crops."""
    out: Path
    """Folder of the results; the same command resumes, and models may be added."""
    model: Annotated[
        shared.Names,
        shared.option(
            "NAME=WHAT: name of a model in the tables, and a model folder, a generator or a PLY; "
            "or the results of another generator: files:DIR (DIR/ID.ply or .glb) or views:DIR "
            "(DIR/ID/VIEW.png, RGBA). May be repeated; each model is compared with the one before."
        ),
    ] = ()
    study: Annotated[
        Path | None,
        shared.option(
            "Study file with rows, seed, target views and perturbations, as `recast eval inputs` "
            "writes it."
        ),
    ] = None
    perturbed: Annotated[str | None, PERTURBED] = None
    targets: Literal["set", "orbit"] = "set"
    """Target views: set (the cameras of the set) or orbit (the paper's: 512 x 512 pixels, 40
    degrees, at twice the longest side of the box)."""
    placement: Literal["views", "canonical"] = "views"
    """Placement of vehicles in their box: views (by the input view, as in `recast eval
    photographs`) or canonical (by the model's forward axis, which the model must have learnt)."""
    seed: Annotated[int, shared.SEED] = 0
    limit: Annotated[int | None, shared.LIMIT] = None
    workers: Annotated[int, shared.WORKERS] = 1
    samples: Annotated[int, shared.SAMPLES] = 200_000
    shown: int = 40
    """Number of vehicles on the image sheets, the first by id."""
    lpips_weights: Annotated[Path | None, shared.LPIPS_WEIGHTS] = None
    clip: Annotated[Path | None, shared.CLIP] = None
    dino: Annotated[Path | None, shared.DINO] = None
    inception: Annotated[Path | None, shared.INCEPTION] = None
    json: Annotated[bool, JSON] = False

    def __call__(self) -> None:
        from recast.core.diagnostics import ProgressBar
        from recast.studies.generation.cells import Measures
        from recast.studies.generation.report import differences_table, paper_table, study_table
        from recast.studies.generation.rows import parse_models, read_rows
        from recast.studies.generation.study import StudySettings, run_study
        from recast.weights import located

        models, beside = parse_models(self.model), dict[str, str]()
        seed, targets, perturbations = self.seed, self.targets, _perturbations(self.perturbed)
        if self.study is not None:
            self._refuse_twice()
            record, rows = read_rows(self.study)
            models, beside = {**rows, **models}, record.beside()
            seed, targets, perturbations = record.seed, record.targets, record.perturbations
        settings = StudySettings(
            models,
            self.set,
            seed,
            self.limit,
            perturbations,
            self.placement,
            Measures(
                located("--lpips-weights", self.lpips_weights),
                located("--clip", self.clip),
                located("--dino", self.dino),
                located("--inception", self.inception),
            ),
            self.samples,
            self.shown,
            targets,
            beside,
        )
        console = console_for(self.json)
        with ProgressBar("vehicles", console) as progress:
            blocks = run_study(settings, self.out, workers=self.workers, progress=progress)
        console.print(f"wrote {self.out}", markup=False)
        if self.json:
            from recast.cli.rows.results import study_rows

            print_json(study_rows(blocks))
            return
        for block in blocks:
            console.print(study_table(block))
            if block.differences:
                console.print(differences_table(block))
            for model, failed in block.failures.items():
                for vehicle, reason in failed.items():
                    console.print(f"not made by {model}: {vehicle}: {reason}", markup=False)
        if beside:
            console.print(paper_table(blocks[0], beside))

    def _refuse_twice(self) -> None:
        from recast.core.errors import InputError

        for option, given in (
            ("--seed", self.seed != 0),
            ("--targets", self.targets != "set"),
            ("--perturbed", self.perturbed is not None),
        ):
            if given:
                raise InputError(option, "value", "is in the study file", "leave it out")


@dataclass(frozen=True)
class EvalInputs:
    """Write the inputs for generators that run elsewhere: the input image of each vehicle, the
    cameras of its target views, and a study file with the rows of the paper."""

    set: tyro.conf.Positional[Path]
    """Vehicle set (its held-out identities are used), or a folder of real crops."""
    out: Path
    """New folder to write to."""
    perturbed: Annotated[str | None, PERTURBED] = None
    targets: Literal["set", "orbit"] = "set"
    """Target views, as for `recast eval generation`."""
    seed: Annotated[int, shared.SEED] = 0
    limit: Annotated[int | None, shared.LIMIT] = None

    def __call__(self) -> None:
        from recast.studies.generation.study import StudySettings, write_inputs

        settings = StudySettings(
            {},
            self.set,
            self.seed,
            self.limit,
            _perturbations(self.perturbed),
            targets=self.targets,
        )
        cases = write_inputs(settings, self.out)
        console_for(False).print(f"wrote {self.out}: inputs of {len(cases)} vehicles", markup=False)


def _perturbations(what: str | None) -> PerturbationConfig | None:
    from recast.recar.perturb import PerturbationConfig, read_perturbations

    if what is None:
        return None
    return PerturbationConfig() if what == "default" else read_perturbations(what)


Eval = shared.group(
    "eval",
    "Evaluate generators of vehicles and planners on recorded images; recast-bridges scores "
    "rollouts.",
    {
        "photographs": EvalPhotographs,
        "actor": EvalActor,
        "planner": EvalPlanner,
        "plans": EvalPlans,
        "generation": EvalGeneration,
        "inputs": EvalInputs,
    },
)
